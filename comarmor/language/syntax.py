"""A policy as data: profiles, rules, and what was decided by them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from comarmor.errors import Location
from comarmor.language.template import Placeholder, Value, for_subject

__all__ = ["PARTS", "PERMISSIONS", "Decision", "Effect", "Expression", "Location", "Profile", "Rule", "Tunable"]


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


@dataclass(frozen=True, slots=True)
class Expression:
    """An attachment, its tunables expanded, in canonical notation.

    Attributes:
        text: ``fnmatch`` expression, in which ``{name}`` and ``{namespace}`` may stand.
        where: where a person wrote it.
        value: its pieces when it depends on the subject; else empty.
    """

    text: str
    where: Location
    value: Value = ()

    @classmethod
    def of(cls, value: Value, where: Location) -> Expression:
        """Return the expression that consists of these pieces."""
        return cls("".join(value), where, value if any(isinstance(p, Placeholder) for p in value) else ())

    def expanded(self, subject: str) -> Expression:
        """Return the expression that this one is for a subject."""
        return Expression(for_subject(self.value, subject), self.where) if self.value else self


@dataclass(frozen=True, slots=True)
class Tunable:
    """A variable: its name, its values (expressions, expanded), and where it is declared."""

    name: str
    values: tuple[Value, ...]
    where: Location


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule of a profile.

    Attributes:
        effect: allow or deny.
        kind: a key of :data:`PERMISSIONS`.
        permissions: permissions of that kind, in its order.
        attachments: what it is about; a name matches when any of them does.
        partitions: DDS partitions as ``fnmatch`` expressions (kind ``topic`` only); empty: not narrowed.
        audit: to be watched, by its own modifier or that of a profile around it.
        where: where a person wrote it.
    """

    effect: Effect
    kind: str
    permissions: tuple[str, ...]
    attachments: tuple[Expression, ...]
    partitions: tuple[str, ...]
    audit: bool
    where: Location


@dataclass(frozen=True, slots=True)
class Profile:
    """A profile.

    Attributes:
        name: a label; need not be unique.
        audit: to be watched, by its own modifier or that of a profile around it.
        attachments: the subjects it applies to, as far as the profiles around it do.
        profiles: the profiles in it.
        rules: its rules.
        where: where a person wrote it.
    """

    name: str
    audit: bool
    attachments: tuple[Expression, ...]
    profiles: tuple[Profile, ...]
    rules: tuple[Rule, ...]
    where: Location


@dataclass(frozen=True, slots=True)
class Decision:
    """What a policy says about one request, and why.

    Attributes:
        kind: kind of the object.
        permission: the permission asked for.
        object: name of the object.
        partitions: DDS partitions of the endpoint; empty: only the default partition.
        effect: allow or deny.
        rules: the rules that decided, in the order of the policy; none when nothing allows it.
        reason: one line for a person.
        parts: for a composite permission, the decision on each part.
    """

    kind: str
    permission: str
    object: str
    partitions: tuple[str, ...]
    effect: Effect
    rules: tuple[Rule, ...]
    reason: str
    parts: tuple[Decision, ...] = ()

    @property
    def allowed(self) -> bool:
        """Whether the request is allowed."""
        return self.effect is Effect.ALLOW

    @property
    def rule(self) -> Rule | None:
        """The first rule that decided, or None when it is denied because nothing allows it."""
        return self.rules[0] if self.rules else None

    @property
    def where(self) -> Location | None:
        """Where the first rule that decided is written."""
        return self.rules[0].where if self.rules else None

    @property
    def audit(self) -> bool:
        """Whether a rule that decided is to be watched."""
        return any(rule.audit for rule in self.rules)
