# SPDX-License-Identifier: Apache-2.0
"""Parse SROS2 policies of the versions 0.2.0 (Foxy and later) and 0.1.0 (Crystal to Eloquent)."""

from __future__ import annotations

import posixpath
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path
from types import MappingProxyType

from comarmor.errors import ComArmorError, Diagnostic
from comarmor.rules import Effect
from comarmor.text import quote
from comarmor.values import dataclass
from keymint_ros2_sros2.policy_files import Placed, read
from keymint_ros2_sros2.syntax import NEW, PERMISSIONS, Entry, NodeGroup, RosNode, RuleList, SourcePolicy, Sros2Enclave


def parse(path: Path) -> SourcePolicy:
    """Read a policy.

    Args:
        path: its file.

    Raises:
        ComArmorError: a file is missing, outside of the policy's folder, or not valid, with ``file:line``.
    """
    root, seen = read(path)
    return _Parser(seen).policy(root)


@dataclass(slots=True)
class _Parser:
    """Parses the elements of a policy in document order.

    Attributes:
        seen: every path that was looked at, with its fingerprint.
        version: of the policy.
        lost: notes about what has no meaning for access control.
    """

    seen: Mapping[Path, bytes]
    version: str = NEW
    lost: list[Diagnostic] = field(default_factory=list)

    def policy(self, root: Placed) -> SourcePolicy:
        """Return the policy of a root element."""
        if root.element.tag != "policy":
            raise _misplaced(root, "as the root", ("policy",))
        self.version = version = root.element.get("version", "")
        inner = "enclaves" if version == NEW else "profiles"
        enclaves: list[Sros2Enclave] = []
        comments: list[str] = [*root.before]
        for child in self.children(root, (inner,), f"in a policy of version {version}"):
            comments += child.comments
            found = self.enclaves(child) if version == NEW else self.nodes_of_old(child)
            for enclave in found:
                enclaves.append(replace(enclave, comments=(*comments, *enclave.comments)))
                comments.clear()
            comments += child.closing
        if not enclaves:
            raise ComArmorError(
                "the policy has no enclave", where=root.where, code="policy-empty",
                help=f"expected <{inner}> with <{'enclave' if version == NEW else 'profile'}> in it",
            )  # fmt: skip
        closing = (*comments, *root.closing)
        return SourcePolicy(version, tuple(enclaves), self.seen, tuple(self.lost), closing)

    def enclaves(self, item: Placed) -> Iterator[Sros2Enclave]:
        """Yield the enclaves of an ``<enclaves>`` element."""
        for child in self.children(item, ("enclave",), "in <enclaves>"):
            groups = tuple(self.group(each) for each in self.children(child, ("profiles",), "in <enclave>"))
            yield Sros2Enclave(child.element.get("path", ""), groups, child.where, child.comments, child.closing)

    def nodes_of_old(self, item: Placed) -> Iterator[Sros2Enclave]:
        """Yield an enclave for each node: up to Eloquent a node had a key of its own, named like the node."""
        group = self.group(item)
        for node in group.nodes:
            path = f"{'' if node.ns in ('', '/') else node.ns.removesuffix('/')}/{node.name}"
            yield Sros2Enclave(path, (NodeGroup((node,), item.where),), node.where)

    def group(self, item: Placed) -> NodeGroup:
        """Return the nodes of a ``<profiles>`` element."""
        if (kind := item.element.get("type")) is not None:
            self.lose(f"the type {quote(kind)} of <profiles>", item)
        nodes = tuple(map(self.node, self.children(item, ("profile",), "in <profiles>")))
        return NodeGroup(nodes, item.where, item.comments, item.closing)

    def node(self, item: Placed) -> RosNode:
        """Return the node of a ``<profile>`` element."""
        names = [item.element.get(attribute) for attribute in ("ns", "node")]
        if names[0] is None or not names[1]:
            raise ComArmorError(
                "<profile> names no node, expected the attributes 'ns' and 'node'", where=item.where, code="schema",
                help='to include its rules alone: xpointer="xpointer(/profile/*)"' if item.chain else "",
            )  # fmt: skip
        lists = tuple(self.rules(child) for child in self.children(item, tuple(PERMISSIONS), "in <profile>"))
        return RosNode(names[0], names[1], lists, item.where, item.comments, item.closing)

    def rules(self, item: Placed) -> RuleList:
        """Return the list of a ``<topics>``, ``<services>`` or ``<actions>`` element."""
        tag = str(item.element.tag)
        entries = tuple(
            Entry(child.element.text or "", child.where, child.comments)
            for child in self.children(item, (tag.removesuffix("s"),), f"in <{tag}>")
        )
        effects = {
            permission: Effect(item.element.get(attribute, ""))
            for attribute, permission in PERMISSIONS[tag].items()
            if item.element.get(attribute) is not None
        }
        return RuleList(
            tag, MappingProxyType(effects), entries, item.where, item.before, item.closing, item.introduction
        )

    def lose(self, what: str, item: Placed) -> None:
        """Note something that no other policy language has, and that SROS2 has since version 0.2.0."""
        if self.version != NEW:
            raise _refused(f"version {self.version} of the policy forbids {what}", item, "remove it")
        self.lost.append(Diagnostic.note("sros2-lost", f"{what} is not taken over", item.where))

    def children(self, item: Placed, expected: tuple[str, ...], place: str) -> Iterator[Placed]:
        """Yield the child elements, which includes may have put into the wrong place; ``<metadata>`` is left out.

        Raises:
            ComArmorError: SROS2, which validates the policy after resolving its includes, refuses them.
        """
        parent, before, is_empty = str(item.element.tag), "", True
        for child in item.children():
            tag = str(child.element.tag)
            if before == "metadata" or (before and parent == "policy"):
                raise _refused(f"<{tag}> is not expected after <{before}>", child, f"expected the end of <{parent}>")
            if tag not in _WITH_BASE and _folder(child) != _folder(item):
                message = f"XInclude adds xml:base to <{tag}>, which comes from another folder"
                raise _refused(message, child, "move the file to the folder of the one that includes it")
            if tag == "metadata" and parent == "profiles":
                self.lose("<metadata>", child)
            elif tag in expected:
                is_empty = False
                yield child
            else:
                raise _misplaced(child, place, expected)
            before = tag
        if is_empty and parent not in _MAY_BE_EMPTY:
            raise _refused(f"<{parent}> has no <{expected[0]}>", item, f"add one, or remove the <{parent}>")


_WITH_BASE = frozenset(("profile", *PERMISSIONS))
"""The elements that may have ``xml:base``, which XInclude 1.0 (4.7.5) adds to what it includes from another folder."""
_MAY_BE_EMPTY = frozenset(("profile", "policy", "enclaves"))
"""A policy without enclaves has an error of its own."""


def _folder(item: Placed) -> str:
    return posixpath.dirname(item.file.name)


def _refused(message: str, item: Placed, help_: str) -> ComArmorError:
    return ComArmorError(f"{message}: SROS2 refuses that", where=item.where, help=help_, code="schema")


def _misplaced(item: Placed, place: str, expected: tuple[str, ...]) -> ComArmorError:
    one_of = " or ".join(f"<{name}>" for name in expected)
    return ComArmorError(
        f"<{item.element.tag}> is not expected {place}, expected {one_of}", where=item.where, code="schema"
    )
