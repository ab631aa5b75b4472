"""Names of ROS 2 entities as DDS topics and partitions; which way a distribution maps them.

:mod:`.modern_names` is the mapping of Bouncy and later, :mod:`.ardent_names` that of Ardent. Both keep raw topics as
they are.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.patterns.glob import Glob
from comarmor.rules import Effect
from comarmor.text import did_you_mean
from keymint.errors import KeymintError
from keymint_ros2_dds.lowering import ardent_names
from keymint_ros2_dds.lowering.entities import IMAGES, Action, Image
from keymint_ros2_dds.lowering.modern_names import image

__all__ = ["ARDENT", "DISTROS", "IMAGES", "Action", "Image", "check_distro", "image", "images", "knows"]

ARDENT = "ardent"
DISTROS = (
    ARDENT, "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble", "iron", "jazzy", "kilted",
    "lyrical", "rolling",
)  # fmt: skip
"""Distributions whose mapping of names is known."""


def images(
    distro: str, expression: Glob, mapped: Image, part: str = "", effect: Effect = Effect.ALLOW
) -> Iterator[tuple[Glob, Glob | None]]:
    """Yield patterns of topics for the names that an expression matches, and the pattern of their partitions.

    The pattern of partitions is None where the mapping says nothing of them.

    Args:
        distro: a known distribution.
        expression: an expression over ROS names, or over DDS names for an image without a prefix.
        mapped: where the names go.
        part: the part of a composite that follows the names.
        effect: what the rule does with the names.
    """
    if distro == ARDENT and mapped.prefix:
        for partition, topic in ardent_names.image(expression, mapped, part, every=effect is Effect.DENY):
            yield topic, partition
    else:
        for topic in image(expression, mapped, part):
            yield topic, None


def knows(distro: str, kind: str) -> bool:
    """Tell whether a distribution has entities of a kind: actions came with Crystal, but Bouncy maps their parts."""
    return distro != ARDENT or kind != "ros_action"


def check_distro(distro: str) -> None:
    """Refuse a distribution whose mapping of names is not known.

    Raises:
        KeymintError: the name is not that of a distribution.
    """
    if distro in DISTROS:
        return
    raise KeymintError(
        f"unknown distro {distro!r}",
        help=did_you_mean(distro, DISTROS, f"use one of {', '.join(DISTROS)}"),
        code="distro-unknown",
    )
