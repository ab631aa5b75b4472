# SPDX-License-Identifier: Apache-2.0
r"""What an SROS2 policy says, with includes resolved: its syntax, the names in it, and the rules that it means.

SROS2's stylesheet resolves names without a look at the rules of ROS names: it trims nothing, and ``~x`` in the node
``/ns/n`` becomes ``/ns/nx``. What it makes of a name is *enforced*; a person who reads the policy expects another
name, or an error. DDS compares the result as an ``fnmatch`` expression, in which braces mean themselves. As a policy
reads, the rules of an enclave are the union of its nodes, in which any DENY overrides every ALLOW.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from comarmor.language.attachments import MOST_CHARACTERS
from comarmor.patterns.expression import canonical
from comarmor.patterns.tokens import COMARMOR, tokenize
from comarmor.rules import Effect, Rule
from comarmor.text import lazy_regex, quote
from comarmor.values import Data
from keymint.errors import Diagnostic, KeymintError, Origin

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


class Entry(Data):
    """A ``<topic>``, ``<service>`` or ``<action>``: its text as it is written, and the comments before it."""

    text: str
    where: Origin
    comments: tuple[str, ...] = ()


class RuleList(Data):
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


class RosNode(Data):
    """A ``<profile>``: the rules of a node, whose names are relative to its namespace ``ns``."""

    ns: str
    name: str
    lists: tuple[RuleList, ...]
    where: Origin
    comments: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()


class NodeGroup(Data):
    """A ``<profiles>``, for which SROS2 writes one grant."""

    nodes: tuple[RosNode, ...]
    where: Origin
    comments: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()


class Sros2Enclave(Data):
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


class SourcePolicy(Data):
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


_PLAIN = lazy_regex(r"[\w/~.]*")
"""Names in which no character has a meaning: most names."""


def enforced_name(node: RosNode, text: str) -> str:
    """Return a name as SROS2's stylesheet resolves it in a node."""
    return _resolved(node.ns, node.name, text)


def as_read(node: RosNode, text: str) -> str:
    """Return a name as it reads: trimmed, ``~x`` as ``~/x``, in a namespace that begins with ``/``."""
    text, ns = text.strip(), node.ns.strip()
    if text.startswith("~") and text[1:2] not in ("", "/"):
        text = f"~/{text[1:]}"
    return _resolved(ns if ns.startswith("/") or not ns else f"/{ns}", node.name.strip(), text)


def _resolved(ns: str, node: str, text: str) -> str:
    base = "" if ns in ("", "/") else ns.removesuffix("/")
    if text.startswith("/"):
        return text
    if text.startswith("~"):
        return f"{base}/{node}{text[1:]}"
    return f"{base}/{text}"


def expression(name: str, entry: Entry) -> str:
    """Return the expression of ComArmor that matches what the standard's ``fnmatch`` matches.

    Args:
        name: a resolved name.
        entry: where it is written.

    Raises:
        KeymintError: the name is too long, or contains notation that POSIX leaves undefined; with ``file:line``.
    """
    try:
        written = name if _PLAIN.fullmatch(name) else canonical(tokenize(name, COMARMOR))
    except KeymintError as error:
        (diagnostic,) = error.diagnostics
        message = f"{quote(entry.text)}: {diagnostic.message}"
        raise KeymintError(message, where=entry.where, help=diagnostic.help, code="expression") from None
    if len(written) > MOST_CHARACTERS:
        message = f"the name is longer than {MOST_CHARACTERS:,} characters"
        raise KeymintError(message, where=entry.where, code="expression")
    return written


GRAPH_TOPIC = "ros_discovery_info"
"""The topic by which participants tell each other their nodes. From Foxy on SROS2 allows it to every enclave."""


def rules_of(enclaves: Iterable[Sros2Enclave], *, graph: bool) -> tuple[Rule, ...]:
    """Return the rules of the enclaves of one path.

    Args:
        enclaves: the enclaves.
        graph: with the rule that SROS2 adds by itself (:attr:`~keymint_ros2_sros2.syntax.SourcePolicy.has_graph`).

    Raises:
        KeymintError: a name is not an expression, with ``file:line``.
    """
    found: list[Rule] = []
    for enclave in enclaves:
        lists = ((node, rules) for node in enclave.nodes() for rules in node.lists)
        for node, rules in lists:
            names = tuple(dict.fromkeys(expression(as_read(node, entry.text), entry) for entry in rules.entries))
            for effect in Effect:
                permissions = tuple(each for each in rules.effects if rules.effects[each] is effect)
                if permissions and names:
                    found.append(Rule(effect, KINDS[rules.tag], permissions, names, (), False, rules.where))
        if graph:
            permissions = ("publish", "subscribe")
            found.append(Rule(Effect.ALLOW, "topic", permissions, (GRAPH_TOPIC,), (), False, enclave.where))
    return tuple(found)
