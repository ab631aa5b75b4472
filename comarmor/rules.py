"""What rules are made of: effects, and the kinds of objects with their permissions."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class Effect(StrEnum):
    """What a rule does with what it matches."""

    ALLOW = "ALLOW"
    DENY = "DENY"


PERMISSIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "topic": ("publish", "subscribe", "relay"),
        "ros_topic": ("ros_publish", "ros_subscribe", "ros_relay"),
        "ros_service": ("ros_call", "ros_execute"),
        "ros_action": ("ros_request", "ros_operate"),
        "ros_parameter": ("ros_read", "ros_write"),
    }
)
"""The kinds of rules, and the permissions that each may hold."""

_GOAL_SERVICES = ("/_action/send_goal", "/_action/cancel_goal", "/_action/get_result")
_GOAL_TOPICS = ("/_action/feedback", "/_action/status")
_READ_SERVICES = ("/describe_parameters", "/get_parameters", "/get_parameter_types", "/list_parameters")
_WRITE_SERVICES = ("/set_parameters", "/set_parameters_atomically")


def _services(permission: str, suffixes: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    return tuple(("ros_service", permission, suffix) for suffix in suffixes)


def _topics(permission: str, suffixes: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    return tuple(("ros_topic", permission, suffix) for suffix in suffixes)


PARTS: Mapping[tuple[str, str], tuple[tuple[str, str, str], ...]] = MappingProxyType(
    {
        ("ros_action", "ros_request"): (
            *_services("ros_call", _GOAL_SERVICES),
            *_topics("ros_subscribe", _GOAL_TOPICS),
        ),
        ("ros_action", "ros_operate"): (
            *_services("ros_execute", _GOAL_SERVICES),
            *_topics("ros_publish", _GOAL_TOPICS),
        ),
        ("ros_parameter", "ros_read"): _services("ros_call", _READ_SERVICES),
        ("ros_parameter", "ros_write"): _services("ros_call", _WRITE_SERVICES),
    }
)
"""What a composite kind and permission stands for: kind, permission and suffix of each part (ROS 2 designs "Actions"
and "Parameters": the names of the topics and services that they are made of)."""


def parts(kind: str, permission: str) -> tuple[tuple[str, str, str], ...]:
    """Return what a permission stands for: its parts, or itself with no suffix when it is not composite."""
    return PARTS.get((kind, permission)) or ((kind, permission, ""),)
