# SPDX-License-Identifier: Apache-2.0
"""The environment variables by which ROS 2 finds a keystore, and requires security.

Foxy renamed them (its release notes, "Renaming of the environment variables"). ``rcl`` compares both switches exactly:
any other strategy starts a node without security if its files are missing (``rcl/security.c``).
"""

from __future__ import annotations

from collections.abc import Collection

from keymint.api import EnvironmentVariable
from keymint_ros2_dds.enclave_layout import LAYOUTS

_BEFORE_FOXY = frozenset(("ardent", "bouncy", "crystal", "dashing", "eloquent"))
_WITHOUT_OVERRIDE = frozenset(("ardent", "bouncy"))
"""A node of these finds its enclave by its name alone; ``ROS_SECURITY_NODE_DIRECTORY`` came with Crystal."""
_SWITCHES = (
    EnvironmentVariable("ROS_SECURITY_ENABLE", "true"),
    EnvironmentVariable("ROS_SECURITY_STRATEGY", "Enforce"),
)


def keystore_variables(distro: str, layout: str) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.ProcessEnvironment.keystore_variables`; an unknown distribution counts as later."""
    if _is_old(distro, layout):
        # The folders of nodes lie directly in the root directory.
        return EnvironmentVariable("ROS_SECURITY_ROOT_DIRECTORY", LAYOUTS[layout].enclaves, is_path=True), *_SWITCHES
    return EnvironmentVariable("ROS_SECURITY_KEYSTORE", "", is_path=True), *_SWITCHES


def enclave_variables(
    distro: str, layout: str, subject: str, files: Collection[str]
) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.ProcessEnvironment.enclave_variables`."""
    del files
    common = keystore_variables(distro, layout)
    if not _is_old(distro, layout):
        return *common, EnvironmentVariable("ROS_SECURITY_ENCLAVE_OVERRIDE", subject)
    if distro in _WITHOUT_OVERRIDE:
        return common
    folder = f"{LAYOUTS[layout].enclaves}{subject}".strip("/")
    return *common, EnvironmentVariable("ROS_SECURITY_NODE_DIRECTORY", folder, is_path=True)


def _is_old(distro: str, layout: str) -> bool:
    """Tell whether nodes read the variables of before Foxy: ``flat`` is the layout of that time."""
    return layout == "flat" or distro in _BEFORE_FOXY
