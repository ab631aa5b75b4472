# SPDX-License-Identifier: Apache-2.0
"""The abstract syntax of an SROS2 policy, with includes resolved."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from comarmor.errors import Diagnostic, Origin
from comarmor.rules import Effect
from comarmor.values import dataclass

NEW = "0.2.0"
"""The version since Foxy. In 0.1.0 nodes have enclaves of their own."""
KINDS: Mapping[str, str] = MappingProxyType({"topics": "ros_topic", "services": "ros_service", "actions": "ros_action"})
"""The kind of rules that each list means."""
PERMISSIONS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "topics": MappingProxyType({"publish": "ros_publish", "subscribe": "ros_subscribe"}),
        "services": MappingProxyType({"request": "ros_call", "reply": "ros_execute"}),
        "actions": MappingProxyType({"call": "ros_request", "execute": "ros_operate"}),
    }
)
"""The permission that each attribute of a list qualifies."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A ``<topic>``, ``<service>`` or ``<action>``: its text as it is written, and the comments before it."""

    text: str
    where: Origin
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RuleList:
    """A list of names with qualifiers.

    Attributes:
        tag: a key of :data:`KINDS`.
        effects: the effect of each permission that an attribute qualifies.
        entries: its names.
        where: where it is written.
        comments: the comments before it.
        closing: the comments after its last name.
        introduction: the comments before the include that brings it.
    """

    tag: str
    effects: Mapping[str, Effect]
    entries: tuple[Entry, ...]
    where: Origin
    comments: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()
    introduction: tuple[str, ...] = ()

    @property
    def included(self) -> bool:
        """Whether another file includes it."""
        return bool(self.where.chain)


@dataclass(frozen=True, slots=True)
class RosNode:
    """A ``<profile>``: the rules of a node, whose names are relative to its namespace ``ns``."""

    ns: str
    name: str
    lists: tuple[RuleList, ...]
    where: Origin
    comments: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NodeGroup:
    """A ``<profiles>``, for which SROS2 writes one grant."""

    nodes: tuple[RosNode, ...]
    where: Origin
    comments: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Sros2Enclave:
    """An ``<enclave>``; in version 0.1.0 a node, which had an enclave of its own.

    Attributes:
        path: its path as it is written.
        groups: its ``<profiles>``.
        where: where it is written.
        comments: the comments before it, and before what is around it.
        closing: the comments at its end.
    """

    path: str
    groups: tuple[NodeGroup, ...]
    where: Origin
    comments: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()

    def nodes(self) -> Iterator[RosNode]:
        """Yield its nodes."""
        for group in self.groups:
            yield from group.nodes


@dataclass(frozen=True, slots=True)
class SourcePolicy:
    """A policy.

    Attributes:
        version: ``0.1.0`` or :data:`NEW`.
        enclaves: in the order of the policy.
        seen: every path that was looked at, with its fingerprint.
        lost: notes about what has no meaning for access control.
        closing: the comments at its end.
    """

    version: str
    enclaves: tuple[Sros2Enclave, ...]
    seen: Mapping[Path, bytes]
    lost: tuple[Diagnostic, ...]
    closing: tuple[str, ...]

    @property
    def has_graph(self) -> bool:
        """Whether SROS2 allows the topic of the graph to every enclave by itself."""
        return self.version == NEW
