# SPDX-License-Identifier: Apache-2.0
"""The error of a denial."""


class rclpy_implementation:  # noqa: N801 - its name in rclpy
    class RCLError(Exception):
        pass
