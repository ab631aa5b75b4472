# SPDX-License-Identifier: Apache-2.0
"""Lowering: rules on ROS names become rules on messages, flows and key expressions of Zenoh.

Both the compiler and the prover (:mod:`keymint_ros2_zenoh.proving`) start from it.
"""
