"""The options that shape a new workspace's profile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

PROFILE_OPTIONS: Sequence[Callable[[Any], Any]] = (
    click.option(
        "--profile-type",
        default="keymint_ros",
        show_default=True,
        metavar="NAME",
        help="Plugin that makes the profile ('keymint plugins' lists them).",
    ),
    click.option("--distro", metavar="NAME", help="ROS 2 distribution [$ROS_DISTRO, else jazzy]."),
    click.option("--domain", type=click.IntRange(0, 230), metavar="N", help="DDS domain id [0]."),
    click.option(
        "--layout",
        type=click.Choice(["sros2", "flat"]),
        help="Layout of the install space: sros2 for Foxy and later, flat for older ones [sros2, for ardent flat].",
    ),
    click.option(
        "--subject-format",
        type=click.Choice(["unique", "sros2"]),
        help="Subject names: CN and a second RDN that no other subject has, or the bare CN of SROS2 [unique].",
    ),
)


def add_options(options: Sequence[Callable[[Any], Any]]) -> Callable[[Any], Any]:
    """Return a decorator that adds options in this order."""

    def decorate(function: Any) -> Any:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate
