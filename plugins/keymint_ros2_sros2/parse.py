# SPDX-License-Identifier: Apache-2.0
"""Parse SROS2 policies of the versions 0.2.0 (Foxy and later) and 0.1.0 (Crystal to Eloquent), with what they include.

SROS2 resolves ``xi:include`` with libxml2, which reads any file of the machine. Here they are read as those of ComArmor
are (:mod:`comarmor.language.source`): within the policy's folder, bounded, and with the place of every element. The
reader of XML removes comments; they are found again: each belongs to the element that follows it.
"""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from xml.parsers import expat  # nosec - the document was read with limits and without a DOCTYPE before

from lxml import etree

from comarmor.language.policy_files import IncludeFormat, PolicyFile, href_of
from comarmor.language.source import load_tree
from comarmor.rules import Effect
from comarmor.text import lazy_regex, quote
from comarmor.values import Data, field, replace
from comarmor.xml import schema
from comarmor.xml.reader import XINCLUDE
from comarmor.xml.sandboxed_paths import path_text
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint_ros2_sros2.syntax import NEW, PERMISSIONS, Entry, NodeGroup, RosNode, RuleList, SourcePolicy, Sros2Enclave


def parse(path: Path) -> SourcePolicy:
    """Read a policy.

    Args:
        path: its file; what it includes is confined to its folder.

    Raises:
        KeymintError: a file is missing, outside of the policy's folder, too large, or not valid, with ``file:line``.
    """
    if os.path.isdir(path):  # noqa: PTH112 - raises nothing
        where, help_ = Origin(path_text(str(path))), "name the file whose root is <policy>"
        message = "is a folder, expected the file of an SROS2 policy"
        raise KeymintError(message, where=where, help=help_, code="policy-missing")
    files = load_tree(path, form=INCLUDES)
    notes: dict[PolicyFile, Comments] = {}
    for document, chain in files.documents():
        schema.validate(document.root, "keymint_ros2_sros2", "policy", document.name, chain)
        notes[document] = comments_of(document.content, document.root)
    (file,) = files.roots
    return _Parser(files.seen).policy(Placed(file.root, file, notes))


# -- files and includes -----------------------------------------------------------------------------------------------


class Comments(Data, eq=False):
    """The comments of a document.

    Attributes:
        before: those between an element and the one before it in its parent, or the parent's start.
        closing: those after the last child of an element.
    """

    before: Mapping[etree._Element, tuple[str, ...]]
    closing: Mapping[etree._Element, tuple[str, ...]]


def comments_of(content: bytes, root: etree._Element) -> Comments:
    """Return the comments of a document.

    Args:
        content: the document.
        root: its root element, from :func:`comarmor.xml.reader.parse`.
    """
    before: dict[etree._Element, tuple[str, ...]] = {}
    closing: dict[etree._Element, tuple[str, ...]] = {}
    pending: list[str] = []
    events = etree.iterwalk(root, events=("start", "end"))  # the same as those of the parser

    def assign(*_of_tag: object) -> None:
        event, element = next(events)
        if pending:
            (before if event == "start" else closing)[element] = tuple(pending)
            pending.clear()

    parser = expat.ParserCreate()
    parser.StartElementHandler = parser.EndElementHandler = assign
    parser.CommentHandler = pending.append
    parser.Parse(content, True)
    closing[root] = (*closing.get(root, ()), *pending)
    return Comments(before, closing)


_DRAFT = "http://www.w3.org/2003/XInclude"
_XPOINTER = lazy_regex(r"\s*xpointer\(\s*((?:/(?:\w+|\*))+)\s*\)\s*")
_BASE = "{http://www.w3.org/XML/1998/namespace}base"


class Placed(Data):
    """An element with its file.

    Attributes:
        element: the element.
        file: its file.
        notes: the comments of all files.
        chain: the places that include the file, innermost first.
        introduction: the comments in the policy's own file before the include that brings the element first.
    """

    element: etree._Element
    file: PolicyFile
    notes: Mapping[PolicyFile, Comments]
    chain: tuple[Origin, ...] = ()
    introduction: tuple[str, ...] = ()

    @property
    def where(self) -> Origin:
        """Where it is written."""
        return self.file.place(self.element, self.chain)

    @property
    def before(self) -> tuple[str, ...]:
        """The comments before it in its file."""
        return self.notes[self.file].before.get(self.element, ())

    @property
    def comments(self) -> tuple[str, ...]:
        """All comments before it: those before the include that brings it, and those in its file."""
        return self.introduction + self.before

    @property
    def closing(self) -> tuple[str, ...]:
        """The comments after its last child."""
        return self.notes[self.file].closing.get(self.element, ())

    def children(self) -> Iterator[Placed]:
        """Yield its child elements, with includes replaced by what they include.

        Raises:
            KeymintError: an xpointer selects nothing, with ``file:line``.
        """
        for element in self.element:
            child = Placed(element, self.file, self.notes, self.chain)
            if element.tag not in INCLUDES.tags:
                yield child
                continue
            file, where = self.file.includes[element], child.where
            introduction = () if self.chain else child.before
            root = Placed(file.root, file, self.notes, (where.alone(), *self.chain))
            for item in _selected(root, _steps(element, where), where):
                yield replace(item, introduction=introduction or item.introduction)
                introduction = ()


def _selected(root: Placed, steps: tuple[str, ...], where: Origin) -> Iterator[Placed]:
    """Yield what an xpointer selects, from what the file includes too; without an xpointer the root element."""
    parents = found = [root] if not steps or steps[0] in {"*", root.element.tag} else []
    for step in steps[1:]:
        parents = found
        found = [child for each in found for child in each.children() if step in {"*", child.element.tag}]
    if not found and not (parents and steps[-1] == "*"):  # all of an empty element is nothing
        message = f"the xpointer /{'/'.join(steps)} selects nothing in {quote(root.file.name, 200)}"
        help_ = f"the root of that file is <{root.element.tag}>"
        raise KeymintError(message, where=where, help=help_, code="include-xpointer")
    yield from found


def _href(element: etree._Element, where: Origin) -> str:
    """Return the ``href`` of an include.

    Raises:
        KeymintError: SROS2 would read another file, or the xpointer has another form, with ``file:line``.
    """
    href = href_of(element, where, ("href", "parse", "xpointer"))
    if (element.text or "").strip():
        raise KeymintError("xi:include must be empty", where=where, code="include-fallback", help="remove the text")
    if any(each.get(_BASE) is not None for each in element.iterancestors()):
        message = "an element around this xi:include has xml:base, from where SROS2 reads the file"
        help_ = "remove xml:base, and write the href relative to this file"
        raise KeymintError(message, where=where, help=help_, code="include-base")
    _steps(element, where)
    return href


INCLUDES = IncludeFormat(
    (f"{{{XINCLUDE}}}include", f"{{{_DRAFT}}}include"),
    _href,
    "copy SROS2's 'common' folder beside the policy: it is in the package sros2, test/policies/common",
)


def _steps(include: etree._Element, where: Origin) -> tuple[str, ...]:
    """Return the steps of the xpointer of an include."""
    xpointer = include.get("xpointer")
    if xpointer is None:
        return ()
    match = _XPOINTER.fullmatch(xpointer)
    if match is None:
        message = f"the xpointer {quote(xpointer)} is not supported"
        help_ = "write xpointer(PATH) with a path of elements, e.g. xpointer(/profile/*); SROS2 refuses a path alone"
        raise KeymintError(message, where=where, help=help_, code="include-xpointer")
    return tuple(match[1][1:].split("/"))


# -- elements ----------------------------------------------------------------------------------------------------------


class _Parser(Data, frozen=False):
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
            help_ = f"expected <{inner}> with <{'enclave' if version == NEW else 'profile'}> in it"
            raise KeymintError("the policy has no enclave", where=root.where, code="policy-empty", help=help_)
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
            message = "<profile> names no node, expected the attributes 'ns' and 'node'"
            help_ = 'to include its rules alone: xpointer="xpointer(/profile/*)"' if item.chain else ""
            raise KeymintError(message, where=item.where, help=help_, code="schema")
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
            KeymintError: SROS2, which validates the policy after resolving its includes, refuses them.
        """
        parent, before, is_empty = str(item.element.tag), "", True
        for child in item.children():
            tag = str(child.element.tag)
            if before == "metadata" or (before and parent == "policy"):
                raise _refused(f"<{tag}> is not expected after <{before}>", child, f"expected the end of <{parent}>")
            if tag not in _WITH_BASE and posixpath.dirname(child.file.name) != posixpath.dirname(item.file.name):
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


def _refused(message: str, item: Placed, help_: str) -> KeymintError:
    return KeymintError(f"{message}: SROS2 refuses that", where=item.where, help=help_, code="schema")


def _misplaced(item: Placed, place: str, expected: tuple[str, ...]) -> KeymintError:
    one_of = " or ".join(f"<{name}>" for name in expected)
    message = f"<{item.element.tag}> is not expected {place}, expected {one_of}"
    return KeymintError(message, where=item.where, code="schema")
