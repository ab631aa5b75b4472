# SPDX-License-Identifier: Apache-2.0
"""The environment variables by which ``rmw_zenoh`` finds configurations (its README, "Configuration").

A session also needs the name of its enclave, which ``ros2 run … --ros-args --enclave …`` gives, and no variable.
"""

from __future__ import annotations

from collections.abc import Collection

from keymint.api import EnvironmentVariable
from keymint_ros2_zenoh.enclave_layout import ENCLAVES, ROUTER, SESSION


def keystore_variables(distro: str, layout: str) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.ProcessEnvironment.keystore_variables`: the router's configuration; nodes ignore it."""
    del distro, layout
    return (EnvironmentVariable("ZENOH_ROUTER_CONFIG_URI", ROUTER, is_path=True),)


def enclave_variables(
    distro: str, layout: str, subject: str, files: Collection[str]
) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.ProcessEnvironment.enclave_variables`; the enclave of a router has no session."""
    if SESSION not in files:
        return keystore_variables(distro, layout)
    return (EnvironmentVariable("ZENOH_SESSION_CONFIG_URI", f"{ENCLAVES}{subject}/{SESSION}", is_path=True),)
