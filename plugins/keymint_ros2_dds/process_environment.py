# SPDX-License-Identifier: Apache-2.0
"""The environment variables by which ROS 2 finds a keystore, and requires security.

Foxy renamed them (its release notes, "Renaming of the environment variables"). ``rcl`` compares both switches exactly:
any other strategy starts a node without security if its files are missing (``rcl/security.c``).
"""

from __future__ import annotations

from collections.abc import Collection

from keymint.api import EnvironmentVariable
from keymint_ros2_dds.enclave_layout import LAYOUTS

_WITH_NODE_DIRECTORY = frozenset(("crystal", "dashing", "eloquent"))
"""The distributions before Foxy in which a variable names the folder of a node itself."""
_BEFORE_FOXY = frozenset(("ardent", "bouncy")) | _WITH_NODE_DIRECTORY
_SWITCHES = (
    EnvironmentVariable("ROS_SECURITY_ENABLE", "true"),
    EnvironmentVariable("ROS_SECURITY_STRATEGY", "Enforce"),
)


def keystore_variables(distro: str, layout: str) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.BuildType.keystore_variables`; an unknown distribution counts as later.

    Ardent and Bouncy look for the name of a node without its namespace: the variables are those of the namespace ``/``.
    """
    if _is_old(distro, layout):
        return _root(LAYOUTS[layout].enclaves), *_SWITCHES
    return EnvironmentVariable("ROS_SECURITY_KEYSTORE", "", is_path=True), *_SWITCHES


def enclave_variables(
    distro: str, layout: str, subject: str, files: Collection[str]
) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.BuildType.enclave_variables`."""
    del files
    if not _is_old(distro, layout):
        return *keystore_variables(distro, layout), EnvironmentVariable("ROS_SECURITY_ENCLAVE_OVERRIDE", subject)
    folder = f"{LAYOUTS[layout].enclaves}{subject}".strip("/")
    if distro in _WITH_NODE_DIRECTORY:
        own = EnvironmentVariable("ROS_SECURITY_NODE_DIRECTORY", folder, is_path=True)
        return *keystore_variables(distro, layout), own
    return _root(folder.rpartition("/")[0]), *_SWITCHES


def _root(folder: str) -> EnvironmentVariable:
    """Return the variable for the folder that has the folders of nodes, relative to the install space."""
    return EnvironmentVariable("ROS_SECURITY_ROOT_DIRECTORY", folder, is_path=True)


def _is_old(distro: str, layout: str) -> bool:
    """Tell whether nodes read the variables of before Foxy: ``flat`` is the layout of that time."""
    return layout == "flat" or distro in _BEFORE_FOXY
