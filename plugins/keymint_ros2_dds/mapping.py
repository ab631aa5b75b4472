"""Names of ROS 2 entities as DDS topics (design.ros2.org, "Topic and Service name mapping to DDS"), Bouncy and later.

A topic ``/a`` is the DDS topic ``rt/a``; a service ``/s`` is the pair ``rq/sRequest`` and ``rr/sReply``; actions and
parameters are made of these. A raw topic is its own name.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from keymint.errors import KeymintError
from keymint.keymake import glob
from keymint.keymake.glob import Glob

DISTROS = (
    "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical",
    "rolling",
)  # fmt: skip
"""Distributions of ROS 2 that map names in this way."""


class Action(StrEnum):
    """What a criterion of a permissions document is about (DDS Security 1.1, 9.4.1.3.2.3)."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    RELAY = "relay"


@dataclass(frozen=True, slots=True)
class Image:
    """One DDS topic of a ROS entity: ``prefix + name + suffix``, and what is done there."""

    action: Action
    prefix: str = ""
    suffix: str = ""


IMAGES: Mapping[str, tuple[Image, ...]] = MappingProxyType(
    {
        "publish": (Image(Action.PUBLISH),),
        "subscribe": (Image(Action.SUBSCRIBE),),
        "relay": (Image(Action.RELAY),),
        "ros_publish": (Image(Action.PUBLISH, "rt"),),
        "ros_subscribe": (Image(Action.SUBSCRIBE, "rt"),),
        "ros_relay": (Image(Action.RELAY, "rt"),),
        "ros_call": (Image(Action.PUBLISH, "rq", "Request"), Image(Action.SUBSCRIBE, "rr", "Reply")),
        "ros_execute": (Image(Action.SUBSCRIBE, "rq", "Request"), Image(Action.PUBLISH, "rr", "Reply")),
    }
)
"""The DDS topics of each permission that is not composite."""


def image(expression: Glob, mapped: Image, part: str = "") -> tuple[Glob, ...]:
    """Return globs for exactly the DDS names of the ROS names that an expression matches.

    A ROS name begins with ``/``. What is left of the expression after that ``/`` says how the name goes on, so
    ``*/scan`` has the images ``rt/scan`` and ``rt/*/scan``, and not ``rt*/scan``.

    Args:
        expression: an expression over ROS names, or over DDS names for an image without a prefix.
        mapped: where the names go.
        part: the part of a composite that follows the names, e.g. ``/_action/status``.
    """
    if not mapped.prefix:
        return (glob.surround("", expression, mapped.suffix),)
    text = glob.literal(expression)
    if text is not None:
        name = text + part
        return ((mapped.prefix + name + mapped.suffix,),) if name.startswith("/") else ()
    after = glob.after(glob.surround("", expression, part), "/")
    return tuple(glob.surround(mapped.prefix + "/", rest, mapped.suffix) for rest in after)


def check_distro(distro: str) -> None:
    """Refuse a distribution whose mapping of names is not known.

    Raises:
        KeymintError: the name is not that of a distribution, or its mapping is not supported.
    """
    if distro in DISTROS:
        return
    if distro == "ardent":
        raise KeymintError(
            "the distro 'ardent' puts ROS names into DDS partitions, and that mapping is not supported",
            help=f"use one of {', '.join(DISTROS)}",
            code="distro-unsupported",
        )
    close = difflib.get_close_matches(distro, DISTROS, 1)
    raise KeymintError(
        f"unknown distro {distro!r}",
        help=f"did you mean {close[0]!r}?" if close else f"use one of {', '.join(DISTROS)}",
        code="distro-unknown",
    )
