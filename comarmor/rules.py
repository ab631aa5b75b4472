# SPDX-License-Identifier: Apache-2.0
"""Rules, and their vocabulary: effects, the kinds of objects with their permissions, and legal ROS names.

Such names are ``/`` and segments of letters, digits and ``_`` that do not begin with a digit (ROS 2 design, "Topic and
Service name mapping to DDS").
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum
from types import MappingProxyType

from comarmor.errors import Origin
from comarmor.text import lazy_regex
from comarmor.values import Data


class Effect(StrEnum):
    """Whether a rule allows or denies the requests that it matches."""

    ALLOW = "ALLOW"
    DENY = "DENY"


class Rule(Data):
    """One rule of a subject, with all tunables and placeholders expanded.

    Attributes:
        effect: allow or deny.
        kind: a key of :data:`PERMISSIONS`.
        permissions: permissions of that kind, without duplicates.
        expressions: POSIX ``fnmatch`` expressions (flags 0, ``\\`` escapes); the rule applies to an object when any of
            them matches its full name.
        partitions: partitions as ``fnmatch`` expressions, for kind ``topic`` only. If empty, an ALLOW applies to
            the default partition (the empty name), a DENY to every partition.
        audit: requests that match the rule are to be logged; changes no decision.
        origin: where the rule is written.
    """

    effect: Effect
    kind: str
    permissions: tuple[str, ...]
    expressions: tuple[str, ...]
    partitions: tuple[str, ...]
    audit: bool
    origin: Origin


class Expectation(Data):
    """A test case of a policy.

    Attributes:
        test: name of the test.
        allowed: True if every matching request must be allowed, False if every one must be denied.
        subject: ``fnmatch`` expression of subjects.
        permission: a permission; its prefix ``ros_`` may be omitted.
        object: ``fnmatch`` expression of objects.
        kind: kind of the objects; empty if it follows from permission and object.
        partition: the partition; empty for the default one.
        where: where the expectation is written.
    """

    test: str
    allowed: bool
    subject: str
    permission: str
    object: str
    partition: str
    where: Origin
    kind: str = ""


PERMISSIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "topic": ("publish", "subscribe", "relay"),
        "ros_topic": ("ros_publish", "ros_subscribe", "ros_relay"),
        "ros_service": ("ros_call", "ros_execute"),
        "ros_action": ("ros_request", "ros_operate"),
        "ros_parameter": ("ros_read", "ros_write"),
    }
)
"""The kinds of rules, and the permissions of each."""
KIND_OF: Mapping[str, str] = MappingProxyType(
    {permission: kind for kind, permissions in PERMISSIONS.items() for permission in permissions}
)
"""The kind of each permission."""

_GOAL_SERVICES = ("/_action/send_goal", "/_action/cancel_goal", "/_action/get_result")
_GOAL_TOPICS = ("/_action/feedback", "/_action/status")
_READ_SERVICES = ("/describe_parameters", "/get_parameters", "/get_parameter_types", "/list_parameters")
_WRITE_SERVICES = ("/set_parameters", "/set_parameters_atomically")


def _parts(kind: str, permission: str, suffixes: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    return tuple((kind, permission, suffix) for suffix in suffixes)


PARTS: Mapping[tuple[str, str], tuple[tuple[str, str, str], ...]] = MappingProxyType(
    {
        ("ros_action", "ros_request"): (
            *_parts("ros_service", "ros_call", _GOAL_SERVICES),
            *_parts("ros_topic", "ros_subscribe", _GOAL_TOPICS),
        ),
        ("ros_action", "ros_operate"): (
            *_parts("ros_service", "ros_execute", _GOAL_SERVICES),
            *_parts("ros_topic", "ros_publish", _GOAL_TOPICS),
        ),
        ("ros_parameter", "ros_read"): _parts("ros_service", "ros_call", _READ_SERVICES),
        ("ros_parameter", "ros_write"): _parts("ros_service", "ros_call", _WRITE_SERVICES),
    }
)
"""The parts of each composite permission: kind, permission and name suffix of the topics and services that implement it
(ROS 2 designs "Actions" and "Parameters")."""


def parts(kind: str, permission: str) -> tuple[tuple[str, str, str], ...]:
    """Return the parts of a permission; a permission that is not composite is its only part, without suffix."""
    return PARTS.get((kind, permission)) or ((kind, permission, ""),)


def suffixes(rule: Rule, kind: str, permission: str) -> Iterator[str]:
    """Yield what follows the names of a rule in the names of the objects on which it has a permission without parts."""
    if rule.kind == kind:
        if permission in rule.permissions:
            yield ""
        return
    for granted in rule.permissions:
        for part_kind, part, suffix in PARTS.get((rule.kind, granted), ()):
            if (part_kind, part) == (kind, permission):
                yield suffix


RAW_PREFIXES = ("rt/", "rq/", "rr/", "rs/", "ra/")
"""What ROS 2 puts before the names of raw topics: of topics, requests, replies, services and actions."""
_RAW_FORMS = {
    ("rt/", ""): ("ros_publish", "ros_subscribe", "ros_relay"),
    ("rq/", "Request"): ("ros_call", "ros_execute"),
    ("rr/", "Reply"): ("ros_execute", "ros_call"),
}
"""Prefix and suffix of the raw topics of topics and services, and what gives the permissions on a raw topic."""
_FULLY_QUALIFIED = lazy_regex(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def of_raw_topic(permission: str, name: str) -> tuple[str, str, str] | None:
    """Return kind, permission and ROS name that give a permission on a raw topic; None if no ROS name maps to it."""
    for (prefix, suffix), given in _RAW_FORMS.items():
        by = dict(zip(PERMISSIONS["topic"], given, strict=False)).get(permission)
        if by and name.startswith(prefix) and name.endswith(suffix):
            return KIND_OF[by], by, f"/{name[len(prefix) : len(name) - len(suffix)]}"
    return None


def is_segment(text: str) -> bool:
    """Whether a text is a legal segment of a ROS name, e.g. ``talker``."""
    return text.isascii() and text.isidentifier()


def is_fully_qualified(name: str) -> bool:
    """Whether a text is a legal fully qualified ROS name, e.g. ``/robot1/talker``."""
    return _FULLY_QUALIFIED.fullmatch(name) is not None


def is_subject(name: str) -> bool:
    """Whether a text is a legal name of a subject: a fully qualified name, or ``/``, the root enclave."""
    return name == "/" or is_fully_qualified(name)
