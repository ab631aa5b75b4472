# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 distributions, and the policy fragments that ship for each."""

from __future__ import annotations

from pathlib import Path

from comarmor.data import locate
from comarmor.errors import Origin
from comarmor.text import did_you_mean
from keymint.errors import ExitCode, KeymintError

_FAMILIES = {
    "ardent": ("ardent",),
    "bouncy": ("bouncy", "crystal", "dashing", "eloquent"),
    "foxy": ("foxy", "galactic", "humble"),
    "iron": ("iron", "jazzy", "kilted", "lyrical", "rolling"),
}
"""Distributions whose nodes need the same permissions.

Nodes of Ardent have no ``rosout`` and are clients of their own parameters; Foxy brings ``ros_discovery_info``, Iron the
type description service.
"""
DISTROS = {distro: family for family, distros in _FAMILIES.items() for distro in distros}
"""For each distribution, the first one of its family."""
_FLAT_WITH_TWO = frozenset(("crystal", "dashing", "eloquent"))
DEFAULT = "jazzy"


def check(distro: str, where: Origin | None = None) -> str:
    """Return the name of a known distribution.

    Raises:
        KeymintError: the distribution is not known; a usage error if ``where`` is None.
    """
    if distro in DISTROS:
        return distro
    raise KeymintError(
        f"unknown ROS 2 distro {distro!r}",
        where=where,
        help=did_you_mean(distro, DISTROS, f"known are {', '.join(DISTROS)}"),
        code="distro-unknown",
        exit_code=ExitCode.FAILURE if where else ExitCode.USAGE,  # without a file, an option or $ROS_DISTRO names it
    )


def layout(distro: str) -> str:
    """Return the layout of the install space that a distribution reads: the flat one before Foxy."""
    return "flat" if DISTROS.get(distro) in {"ardent", "bouncy"} else "sros2"


def has_one_authority(distro: str, layout: str) -> bool:
    """Tell whether nodes have one file for the issuer of identities and the signer of permissions.

    In the flat layout, Crystal to Eloquent have two; nothing later reads it.
    """
    return layout == "flat" and distro not in _FLAT_WITH_TWO


def library(distro: str) -> Path:
    """Return the folder of the policy fragments shipped for a distribution, such as ``common/node.xml``.

    Raises:
        KeymintError: the distribution is not known.
    """
    return locate("keymint_ros", "templates") / "comarmor.d" / DISTROS[check(distro)]
