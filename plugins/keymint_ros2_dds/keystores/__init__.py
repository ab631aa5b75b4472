# SPDX-License-Identifier: Apache-2.0
"""Keystores that other tools made: what their files contain, what their documents grant, and which are kept.

Start at :mod:`~keymint_ros2_dds.keystores.keystore_contents`. What is right and wrong about them is judged in
:mod:`keymint_ros2_dds.examine`.
"""
