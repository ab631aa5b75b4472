# SPDX-License-Identifier: Apache-2.0
"""As much of rclpy as a stand-in node uses; ``FAKE_ALLOWED`` lists what is allowed: ``publisher /a,client /b``."""

import os
import sys
from pathlib import Path

from rclpy.impl.implementation_singleton import rclpy_implementation


def get_rmw_implementation_identifier():
    return os.environ.get("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")


def init(args):
    print("a library prints")  # noqa: T201
    print("and complains", file=sys.stderr)  # noqa: T201
    enclave = args[args.index("--enclave") + 1]
    folder = f"{os.environ.get('ROS_SECURITY_KEYSTORE')}/enclaves{enclave}"
    if os.environ["ROS_SECURITY_ENABLE"] == "true" and not Path(folder).is_dir():
        raise rclpy_implementation.RCLError(f"SECURITY ERROR: directory '{folder}'\n does not exist")
