# SPDX-License-Identifier: Apache-2.0
"""Processes with real Zenoh sessions that know the commands of :mod:`zenoh_test_program`."""

from __future__ import annotations

from pathlib import Path

from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohSystem


class ZenohTestSystem(ZenohSystem):
    """Processes of real Zenoh, with more commands."""

    PROGRAM = Path(__file__).with_name("zenoh_test_program.py")
