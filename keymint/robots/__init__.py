# SPDX-License-Identifier: Apache-2.0
"""Requests of robots that make their own key, and the bundles that answer them. Frozen data, and bytes.

Start at :mod:`~keymint.robots.bundle`, which signs and verifies one; :mod:`keymint.examine.bundles` decides whether a
robot may take it, given what it has (:mod:`~keymint.robots.robot_keystore`).
"""
