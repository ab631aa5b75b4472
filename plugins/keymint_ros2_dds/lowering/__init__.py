# SPDX-License-Identifier: Apache-2.0
"""Lowering: rules on ROS names become patterns of DDS topics and partitions; open ``lowered_rules`` first.

Both the compiler (:mod:`keymint_ros2_dds.compiling`) and the prover (:mod:`keymint_ros2_dds.proving`) start from it.
"""
