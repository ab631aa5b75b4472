# SPDX-License-Identifier: Apache-2.0
"""The matcher of expressions that the access-control plugin of Cyclone DDS exports."""

from __future__ import annotations

import ctypes

from keymint_ros2_dds.vendors.cyclone_access_control import library


def ac_fnmatch(expression: bytes, name: bytes) -> bool:
    """Tell whether an expression matches the name of a topic or partition, as Cyclone DDS does."""
    matcher = library().plugin.ac_fnmatch
    matcher.argtypes = [ctypes.c_char_p, ctypes.c_char_p]
    matcher.restype = ctypes.c_bool
    return bool(matcher(expression, name))
