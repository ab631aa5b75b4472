# SPDX-License-Identifier: Apache-2.0
"""Read the files of an SROS2 policy, and go through its elements with what it includes in the place of the includes.

SROS2 resolves ``xi:include`` with libxml2, which reads any file of the machine. Here they are read as those of ComArmor
are (:mod:`comarmor.language.source`): within the policy's folder, bounded, and with the place of every element. The
reader of XML removes comments; they are found again: each belongs to the element that follows it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from xml.parsers import expat  # nosec - the document was read with limits and without a DOCTYPE before

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Origin
from comarmor.language.policy_files import IncludeFormat, PolicyFile, href_of
from comarmor.language.source import load_tree
from comarmor.regex import lazy_regex
from comarmor.text import quote
from comarmor.values import dataclass
from comarmor.xml import schema
from comarmor.xml.reader import XINCLUDE
from comarmor.xml.sandboxed_paths import path_text


@dataclass(frozen=True, slots=True, eq=False)
class Comments:
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
    around: list[etree._Element] = []
    pending: list[str] = []
    elements = root.iter()

    def start(_tag: str, _attributes: Mapping[str, str]) -> None:
        around.append(next(elements))
        assign(before)

    def end(_tag: str) -> None:
        assign(closing)
        around.pop()

    def assign(to: dict[etree._Element, tuple[str, ...]]) -> None:
        if pending:
            to[around[-1]] = tuple(pending)
            pending.clear()

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CommentHandler = pending.append
    parser.Parse(content, True)
    closing[root] = (*closing.get(root, ()), *pending)
    return Comments(before, closing)


_DRAFT = "http://www.w3.org/2003/XInclude"
_XPOINTER = lazy_regex(r"\s*xpointer\(\s*((?:/(?:\w+|\*))+)\s*\)\s*")
_BASE = "{http://www.w3.org/XML/1998/namespace}base"


@dataclass(frozen=True, slots=True)
class Placed:
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
            ComArmorError: an xpointer selects nothing, with ``file:line``.
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


def read(path: Path) -> tuple[Placed, Mapping[Path, bytes]]:
    """Read a policy: return its root element, and every path that was looked at with the SHA-256 of its bytes.

    Args:
        path: the file; what it includes is confined to its folder.

    Raises:
        ComArmorError: a file is missing, outside of the folder, too large, or not valid, with ``file:line``.
    """
    if os.path.isdir(path):  # noqa: PTH112 - raises nothing
        raise ComArmorError(
            "is a folder, expected the file of an SROS2 policy", where=Origin(path_text(str(path))),
            code="policy-missing", help="name the file whose root is <policy>",
        )  # fmt: skip
    files = load_tree(path, form=INCLUDES)
    notes: dict[PolicyFile, Comments] = {}
    for document, chain in files.documents():
        schema.validate(document.root, locate("keymint_ros2_sros2", "schemas") / "policy.xsd", document.name, chain)
        notes[document] = comments_of(document.content, document.root)
    (file,) = files.roots
    return Placed(file.root, file, notes), files.seen


def _selected(root: Placed, steps: tuple[str, ...], where: Origin) -> Iterator[Placed]:
    """Yield what an xpointer selects, from what the file includes too; without an xpointer the root element."""
    parents = found = [root] if not steps or steps[0] in {"*", root.element.tag} else []
    for step in steps[1:]:
        parents = found
        found = [child for each in found for child in each.children() if step in {"*", child.element.tag}]
    if not found and not (parents and steps[-1] == "*"):  # all of an empty element is nothing
        raise ComArmorError(
            f"the xpointer /{'/'.join(steps)} selects nothing in {quote(root.file.name, 200)}", where=where,
            help=f"the root of that file is <{root.element.tag}>", code="include-xpointer",
        )  # fmt: skip
    yield from found


def _href(element: etree._Element, where: Origin) -> str:
    """Return the ``href`` of an include.

    Raises:
        ComArmorError: SROS2 would read another file, or the xpointer has another form, with ``file:line``.
    """
    href = href_of(element, where, ("href", "parse", "xpointer"))
    if (element.text or "").strip():
        raise ComArmorError("xi:include must be empty", where=where, code="include-fallback", help="remove the text")
    if any(each.get(_BASE) is not None for each in element.iterancestors()):
        raise ComArmorError(
            "an element around this xi:include has xml:base, from where SROS2 reads the file", where=where,
            code="include-base", help="remove xml:base, and write the href relative to this file",
        )  # fmt: skip
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
        raise ComArmorError(
            f"the xpointer {quote(xpointer)} is not supported", where=where, code="include-xpointer",
            help="write xpointer(PATH) with a path of elements, e.g. xpointer(/profile/*); SROS2 refuses a path alone",
        )  # fmt: skip
    return tuple(match[1][1:].split("/"))
