# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 distributions, and the policy fragments that ship for each."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from comarmor.data import locate
from comarmor.text import did_you_mean
from keymint.errors import ExitCode, KeymintError, Origin

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
    return check_choice("ROS 2 distro", distro, DISTROS, "distro-unknown", where)


def check_choice(noun: str, value: str, known: Collection[str], code: str, where: Origin | None = None) -> str:
    """Return a value that is one of several.

    Args:
        noun: what it is, for the message.
        value: the value.
        known: the values that there are.
        code: code of the error.
        where: the place in a document that gives it; None if an option or the environment does.

    Raises:
        KeymintError: it is another one; a usage error if ``where`` is None.
    """
    if value in known:
        return value
    message = f"unknown {noun} {value!r}"
    help_ = did_you_mean(value, known, f"known are {', '.join(known)}")
    exit_code = ExitCode.FAILURE if where else ExitCode.USAGE
    raise KeymintError(message, where=where, help=help_, code=code, exit_code=exit_code)


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
