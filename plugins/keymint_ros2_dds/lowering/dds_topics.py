# SPDX-License-Identifier: Apache-2.0
"""The DDS topics that a ROS entity uses (design.ros2.org, "Topic and Service name mapping to DDS")."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType

from comarmor.rules import parts
from comarmor.values import dataclass


class TopicAction(StrEnum):
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

    action: TopicAction
    prefix: str = ""
    suffix: str = ""


DDS_TOPICS: Mapping[str, tuple[DdsTopic, ...]] = MappingProxyType(
    {
        "publish": (DdsTopic(TopicAction.PUBLISH),),
        "subscribe": (DdsTopic(TopicAction.SUBSCRIBE),),
        "relay": (DdsTopic(TopicAction.RELAY),),
        "ros_publish": (DdsTopic(TopicAction.PUBLISH, "rt"),),
        "ros_subscribe": (DdsTopic(TopicAction.SUBSCRIBE, "rt"),),
        "ros_relay": (DdsTopic(TopicAction.RELAY, "rt"),),
        "ros_call": (DdsTopic(TopicAction.PUBLISH, "rq", "Request"), DdsTopic(TopicAction.SUBSCRIBE, "rr", "Reply")),
        "ros_execute": (DdsTopic(TopicAction.SUBSCRIBE, "rq", "Request"), DdsTopic(TopicAction.PUBLISH, "rr", "Reply")),
    }
)
"""The DDS topics of each permission that is not composite."""


@lru_cache(maxsize=256)
def needed_topics(kind: str, permissions: tuple[str, ...]) -> tuple[tuple[DdsTopic, str], ...]:
    """Return the DDS topics of permissions, with the suffix of each part.

    Raises:
        KeyError: DDS does not know a permission.
    """
    needed = ((part, suffix) for permission in permissions for _, part, suffix in parts(kind, permission))
    return tuple((topic, suffix) for part, suffix in needed for topic in DDS_TOPICS[part])
