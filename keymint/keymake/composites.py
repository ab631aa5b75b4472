"""Composite kinds: what the rules for actions and parameters stand for.

Actions and parameters are made of services and topics in ROS 2 (design.ros2.org, "Actions" and "Parameter API"),
so their rules are shorthands, for ALLOW and DENY alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

_ACTION_SERVICES = ("/_action/send_goal", "/_action/cancel_goal", "/_action/get_result")
_ACTION_TOPICS = ("/_action/feedback", "/_action/status")
_READ = ("/describe_parameters", "/get_parameters", "/get_parameter_types", "/list_parameters")
_WRITE = ("/set_parameters", "/set_parameters_atomically")


def _parts(kind: str, permission: str, suffixes: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    return tuple((kind, permission, suffix) for suffix in suffixes)


PARTS: Mapping[tuple[str, str], tuple[tuple[str, str, str], ...]] = MappingProxyType(
    {
        ("ros_action", "ros_request"): (
            *_parts("ros_service", "ros_call", _ACTION_SERVICES),
            *_parts("ros_topic", "ros_subscribe", _ACTION_TOPICS),
        ),
        ("ros_action", "ros_operate"): (
            *_parts("ros_service", "ros_execute", _ACTION_SERVICES),
            *_parts("ros_topic", "ros_publish", _ACTION_TOPICS),
        ),
        ("ros_parameter", "ros_read"): _parts("ros_service", "ros_call", _READ),
        ("ros_parameter", "ros_write"): _parts("ros_service", "ros_call", _WRITE),
    }
)
"""(kind, permission) -> its parts: (kind, permission, suffix that is appended to the expression)."""


def parts(kind: str, permission: str) -> tuple[tuple[str, str, str], ...]:
    """Return what a permission stands for: its parts, or itself with no suffix when it is not composite."""
    return PARTS.get((kind, permission)) or ((kind, permission, ""),)
