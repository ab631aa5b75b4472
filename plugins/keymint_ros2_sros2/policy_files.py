# SPDX-License-Identifier: Apache-2.0
"""Read the files of an SROS2 policy and resolve their includes, which are confined to the policy's folder.

SROS2 resolves ``xi:include`` with libxml2, which reads any file of the machine. Here includes are resolved as those of
ComArmor are (:mod:`comarmor.language.source`): within the folder, bounded, and with the place of every element.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Origin
from comarmor.regex import lazy_regex
from comarmor.text import quoted
from comarmor.values import dataclass
from comarmor.xml import includes, schema
from comarmor.xml.include_elements import href_of
from comarmor.xml.reader import LIMITS, XINCLUDE, Limits, parse, place
from comarmor.xml.sandboxed_paths import (
    SandboxedFolder,
    exists,
    path_text,
    read_in,
    resolve,
    similar_file,
    unreadable,
)
from keymint_ros2_sros2.comments import Comments, comments_of

_DRAFT = "http://www.w3.org/2003/XInclude"
_INCLUDES = (f"{{{XINCLUDE}}}include", f"{{{_DRAFT}}}include")
_XPOINTER = lazy_regex(r"\s*(?:xpointer\(\s*)?((?:/(?:\w+|\*))+)(?:\s*\))?\s*")
_BASE = "{http://www.w3.org/XML/1998/namespace}base"
_ATTRIBUTES = ("href", "parse", "xpointer")
_COPY = "copy the file into the policy's folder, and include the copy"


@dataclass(frozen=True, slots=True, eq=False)
class PolicyFile:
    """One file of a policy.

    Attributes:
        name: path as the user would type it.
        relative: path in the policy's folder.
        root: the root element, with its includes.
        comments: its comments.
    """

    name: str
    relative: str
    root: etree._Element
    comments: Comments


@dataclass(frozen=True, slots=True)
class Placed:
    """An element with its file.

    Attributes:
        element: the element.
        file: its file.
        chain: the places that include the file, innermost first.
        introduction: the comments in the policy's own file before the include that brings the element first.
    """

    element: etree._Element
    file: PolicyFile
    chain: tuple[Origin, ...] = ()
    introduction: tuple[str, ...] = ()

    @property
    def where(self) -> Origin:
        """Where it is written."""
        line, column = place(self.element)
        return Origin(self.file.name, line, self.chain, column)

    @property
    def before(self) -> tuple[str, ...]:
        """The comments before it in its file."""
        return self.file.comments.before.get(self.element, ())

    @property
    def comments(self) -> tuple[str, ...]:
        """All comments before it: those before the include that brings it, and those in its file."""
        return self.introduction + self.before

    @property
    def closing(self) -> tuple[str, ...]:
        """The comments after its last child."""
        return self.file.comments.closing.get(self.element, ())


@dataclass(slots=True)
class PolicyFiles:
    """Reads each file of a policy once.

    Attributes:
        folder: the folder that files are confined to.
        limits: limits of files and includes.
        seen: every path that was looked at, with the SHA-256 of its bytes; empty for one that does not exist.
    """

    folder: SandboxedFolder
    limits: Limits = LIMITS
    seen: dict[Path, bytes] = field(default_factory=dict)
    _files: dict[str, PolicyFile] = field(default_factory=dict)
    _bytes: int = 0
    _nodes: int = 0
    _inclusions: int = 0

    def root(self, relative: str) -> Placed:
        """Return the root element of a file.

        Raises:
            ComArmorError: the file is missing, outside of the folder, too large, or not valid, with ``file:line``.
        """
        file = self._file(relative, Origin(self.folder.name(relative)), ())
        return Placed(file.root, file)

    def children(self, item: Placed) -> Iterator[Placed]:
        """Yield the child elements of an element, with includes replaced by what they include.

        Raises:
            ComArmorError: an include is not usable, or there are too many, with ``file:line``.
        """
        for element in item.element:
            child = Placed(element, item.file, item.chain)
            if element.tag in _INCLUDES:
                yield from self._included(child)
                continue
            self._count(1, child.where)
            yield child

    def _count(self, nodes: int, where: Origin) -> None:
        self._nodes += nodes
        if self._nodes > self.limits.nodes:
            raise _limit(f"with its includes the policy has more than {self.limits.nodes:,} elements", where)

    def _included(self, include: Placed) -> Iterator[Placed]:
        where = include.where
        self._inclusions += 1
        if len(include.chain) >= self.limits.include_depth:
            raise _limit(f"includes are nested more than {self.limits.include_depth} deep", where)
        if self._inclusions > self.limits.inclusions:
            raise _limit(f"the policy has more than {self.limits.inclusions:,} includes", where)
        href, steps = _target(include)
        target = posixpath.normpath(posixpath.join(posixpath.dirname(include.file.relative), href))
        chain = (where.alone(), *include.chain)
        if self.folder.name(target) in {each.file for each in chain}:
            raise ComArmorError(
                f"{quoted(href, 200)} includes itself", where=where, code="include-loop", help="remove the include"
            )
        if target not in self._files and not exists(self.folder, target, where):
            self.seen[self.folder.place(target)] = b""
            raise ComArmorError(
                f"the included file {quoted(href, 200)} does not exist", where=where, code="include-missing",
                help=similar_file(self.folder, target, include.file.name)
                or "copy SROS2's 'common' folder beside the policy: it is in the package sros2, test/policies/common",
            )  # fmt: skip
        file = self._file(target, where, chain)
        introduction = () if include.chain else include.before
        for item in self._selected(Placed(file.root, file, chain), steps, where):
            yield replace(item, introduction=introduction or item.introduction)
            introduction = ()

    def _selected(self, root: Placed, steps: tuple[str, ...], where: Origin) -> Iterator[Placed]:
        """Yield what an xpointer selects, from what the file includes too; without an xpointer the root element."""
        parents = found = [root] if not steps or steps[0] in {"*", root.element.tag} else []
        for step in steps[1:]:
            parents = found
            found = [child for each in found for child in self.children(each) if step in {"*", child.element.tag}]
        if not found and not (parents and steps[-1] == "*"):  # all of an empty element is nothing
            raise ComArmorError(
                f"the xpointer /{'/'.join(steps)} selects nothing in {quoted(root.file.name, 200)}", where=where,
                help=f"the root of that file is <{root.element.tag}>", code="include-xpointer",
            )  # fmt: skip
        yield from found

    def _file(self, relative: str, where: Origin, chain: tuple[Origin, ...]) -> PolicyFile:
        if relative in self._files:
            return self._files[relative]
        name = self.folder.name(relative)
        real = resolve(self.folder, relative, where)
        content = read_in(self.folder, real, self.limits.file_bytes + 1, where)
        self._bytes += len(content)
        if self._bytes > self.limits.total_bytes:
            raise _limit(f"the policy has more than the {self.limits.total_bytes:,} bytes allowed", where)
        self.seen[self.folder.place(relative)] = hashlib.sha256(content).digest()
        root = parse(content, name, limits=self.limits, chain=chain)
        schema.validate(root, locate("keymint_ros2_sros2", "schemas") / "policy.xsd", name, chain)
        file = self._files[relative] = PolicyFile(name, relative, root, comments_of(content, root))
        return file


def policy_files(path: Path) -> tuple[PolicyFiles, str]:
    """Return the reader of a policy, and the name of its root file.

    Args:
        path: the file; what it includes is confined to its folder.

    Raises:
        ComArmorError: there is no such file.
    """
    shown = path_text(str(path))
    try:
        real = path.resolve(strict=True)
    except (OSError, RuntimeError, ValueError) as error:
        raise ComArmorError(unreadable(error, "the policy"), where=Origin(shown), code="policy-missing") from None
    if real.is_dir():
        raise ComArmorError(
            "is a folder, expected the file of an SROS2 policy", where=Origin(shown), code="policy-missing",
            help="name the file whose root is <policy>",
        )  # fmt: skip
    folder = str(real.parent if path.is_symlink() else path.parent)
    return PolicyFiles(SandboxedFolder(real.parent, folder)), real.name


def _target(include: Placed) -> tuple[str, tuple[str, ...]]:
    """Return the path that an include refers to, and the steps of its xpointer.

    Raises:
        ComArmorError: it is not a plain relative path, or another form of xpointer, with ``file:line``.
    """
    element, where = include.element, include.where
    href = href_of(element, where, _ATTRIBUTES)
    if (element.text or "").strip():
        raise ComArmorError("xi:include must be empty", where=where, code="include-fallback", help="remove the text")
    if any(each.get(_BASE) is not None for each in element.iterancestors()):
        raise ComArmorError(
            "an element around this xi:include has xml:base, from where SROS2 reads the file", where=where,
            code="include-base", help="remove xml:base, and write the href relative to this file",
        )  # fmt: skip
    return includes.path_of(href, where, help_=_COPY), _steps(element.get("xpointer"), where)


def _steps(xpointer: str | None, where: Origin) -> tuple[str, ...]:
    if xpointer is None:
        return ()
    match = _XPOINTER.fullmatch(xpointer)
    if match is None:
        raise ComArmorError(
            f"the xpointer {quoted(xpointer)} is not supported", where=where, code="include-xpointer",
            help="write a path of elements, e.g. xpointer(/profile/*)",
        )  # fmt: skip
    return tuple(match[1][1:].split("/"))


def _limit(message: str, where: Origin) -> ComArmorError:
    return ComArmorError(message, where=where, code="xml-limit")
