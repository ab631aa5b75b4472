"""The DDS topics that a ROS entity is made of (design.ros2.org, "Topic and Service name mapping to DDS")."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType


class Action(StrEnum):
    """What a criterion of a permissions document is about (DDS Security 1.1, 9.4.1.3.2.3)."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    RELAY = "relay"


@dataclass(frozen=True, slots=True)
class Image:
    """One DDS topic of a ROS entity, and what is done there.

    Attributes:
        action: what is done.
        prefix: ROS subsystem: ``rt``, ``rq`` or ``rr``; empty for a raw topic, which is its own name.
        suffix: what follows the ROS name in that of the topic.
    """

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
