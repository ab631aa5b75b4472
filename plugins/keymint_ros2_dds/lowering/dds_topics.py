"""The DDS topics that a ROS entity uses (design.ros2.org, "Topic and Service name mapping to DDS")."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType


class Action(StrEnum):
    """What a rule of a permissions document permits or denies (DDS Security 1.1, 9.4.1.3.2.3)."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    RELAY = "relay"


@dataclass(frozen=True, slots=True)
class DdsTopic:
    """A DDS topic of a ROS entity, and the action that a permission needs on it.

    Attributes:
        action: publish, subscribe or relay.
        prefix: ROS subsystem: ``rt``, ``rq`` or ``rr``; empty for a raw topic, which keeps its name.
        suffix: text after the ROS name.
    """

    action: Action
    prefix: str = ""
    suffix: str = ""


DDS_TOPICS: Mapping[str, tuple[DdsTopic, ...]] = MappingProxyType(
    {
        "publish": (DdsTopic(Action.PUBLISH),),
        "subscribe": (DdsTopic(Action.SUBSCRIBE),),
        "relay": (DdsTopic(Action.RELAY),),
        "ros_publish": (DdsTopic(Action.PUBLISH, "rt"),),
        "ros_subscribe": (DdsTopic(Action.SUBSCRIBE, "rt"),),
        "ros_relay": (DdsTopic(Action.RELAY, "rt"),),
        "ros_call": (DdsTopic(Action.PUBLISH, "rq", "Request"), DdsTopic(Action.SUBSCRIBE, "rr", "Reply")),
        "ros_execute": (DdsTopic(Action.SUBSCRIBE, "rq", "Request"), DdsTopic(Action.PUBLISH, "rr", "Reply")),
    }
)
"""The DDS topics of each permission that is not composite."""
