# SPDX-License-Identifier: Apache-2.0
"""Reads the XML documents of profiles and packages: safely, strictly, and identical ones only once.

Plugins that own such a document use it too, e.g. a build type that reads a part of a package.

Many packages of a workspace contain identical documents. The result of reading one is therefore cached by content.
Reading does not know the document's name; :class:`Reader` inserts it into the messages afterwards.
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Container, Mapping, Sequence
from functools import lru_cache
from typing import Generic, TypeVar

from lxml import etree

from comarmor.text import did_you_mean, quote
from comarmor.values import replace
from comarmor.xml import reader, schema
from comarmor.xml.reader import line
from keymint.api import DomainRange
from keymint.errors import Diagnostic, KeymintError, Origin, known_authority

_T = TypeVar("_T")

DEFAULT_DOMAINS = (DomainRange(0, 0),)
"""The domains where neither a package's document nor its defaults name any."""
_NAMELESS = "<document>"
_CACHE_SIZE = 256
"""Documents of one kind to cache: enough for all that packages share."""


class Reader(Generic[_T]):
    """Reads documents of one kind.

    Args:
        owner: package that owns the schema, e.g. ``keymint_ros``.
        schema_name: name of the schema in ``schemas/<owner>/``, without its suffix.
        convert: turns a valid root element into immutable data, whose places have a line but no file.
        among: see :func:`comarmor.xml.schema.validate`.
    """

    def __init__(
        self,
        owner: str,
        schema_name: str,
        convert: Callable[[etree._Element], _T],
        among: tuple[str, str] | None = None,
    ) -> None:
        @lru_cache(maxsize=_CACHE_SIZE)
        def read(content: bytes) -> _T:
            return convert(parse(content, _NAMELESS, owner, schema_name, among))

        self._read = read

    def __call__(self, content: bytes, name: str) -> _T:
        """Return the data of a document.

        Args:
            content: the document.
            name: its path as the user would type it, for messages.

        Raises:
            KeymintError: the document is not well-formed or not valid, with ``file:line`` of each defect.
        """
        try:
            return self._read(content)
        except KeymintError as error:
            raise KeymintError.of(_named(diagnostic, name) for diagnostic in error.diagnostics) from None


def parse(
    content: bytes, name: str, owner: str, schema_name: str, among: tuple[str, str] | None = None
) -> etree._Element:
    """Return the root element of a document that is valid against a schema.

    Args:
        content: the document.
        name: its path as the user would type it, for messages.
        owner: package that owns the schema.
        schema_name: name of the schema, without its suffix.
        among: see :func:`comarmor.xml.schema.validate`.

    Raises:
        KeymintError: the document is not well-formed or not valid.
    """
    root = reader.parse(content, name)
    schema.validate(root, owner, schema_name, name, among=among)
    return root


def _named(diagnostic: Diagnostic, name: str) -> Diagnostic:
    where = diagnostic.where
    return replace(diagnostic, where=Origin(name, where.line)) if where and where.file == _NAMELESS else diagnostic


def place(element: etree._Element) -> Origin:
    """Return the place of an element in the document that is being read."""
    return Origin(_NAMELESS, line(element))


def text(element: etree._Element | None) -> str | None:
    """Return the text of an element without surrounding white space, or None if there is no element."""
    return None if element is None else (element.text or "").strip()


def require_new(name: str, known: Container[str], element: etree._Element, message: str, help_: str, code: str) -> None:
    """Check that no element before this one has the same name.

    Args:
        name: what the element defines.
        known: what the elements before it defined.
        element: the element.
        message: text of the error.
        help_: what to do about it.
        code: code of the error.

    Raises:
        KeymintError: the name is known already.
    """
    if name in known:
        raise KeymintError(message, where=place(element), help=help_, code=code)


def domains(element: etree._Element | None) -> tuple[DomainRange, ...]:
    """Return the domains that a ``<domains>`` element lists; empty if there is no element.

    Raises:
        KeymintError: a range ends before it begins.
    """
    ranges = []
    for item in () if element is None else element:
        ends = [int(text(end) or "") for end in item] or [int(text(item) or "")]
        if ends[0] > ends[-1]:
            message = f"the range of domains ends at {ends[-1]}, before its start at {ends[0]}"
            raise KeymintError(message, where=place(item), help="exchange <min> and <max>", code="domain-range")
        ranges.append(DomainRange(ends[0], ends[-1]))
    return tuple(dict.fromkeys(ranges))


def signer(named: str, named_at: Origin, default: str, default_at: Origin, known: Sequence[str]) -> str:
    """Return the authority that signs a document of a package.

    Args:
        named: the authority that the manifest names; empty if it names none.
        named_at: its place.
        default: the authority that the defaults name; empty if they name none.
        default_at: the place of the defaults.
        known: names of the profile's authorities; if there is only one, it need not be named.

    Raises:
        KeymintError: there is no such authority, or none is named.
    """
    if named:
        return known_authority(named, known, named_at, "signs this")
    only = known[0] if len(known) == 1 else ""
    return known_authority(default or only, known, default_at, "signs this")


def incomplete(owner: str, tag: str, defaults: Origin) -> KeymintError:
    """Return the error for a ``certificate`` or ``grant`` that lacks an element in its document and its defaults."""
    message = f"the {owner} has no <{tag}>, neither in its own document nor in these defaults"
    return KeymintError(message, where=defaults, help=f"add a <{tag}>", code=f"{owner}-incomplete")


def file_in(files: Mapping[str, bytes], path: str, where: Origin, space: str) -> bytes:
    """Return a file that a document names.

    Args:
        files: the files by path relative to their space.
        path: the path as the document gives it.
        where: the place that gives it.
        space: the noun for the collection of files, for messages.

    Raises:
        KeymintError: the path leads out of the space, or there is no such file.
    """
    inside = normal_path(path, where)
    if inside not in files:
        message = f"there is no file {quote(path, 200)} in the {space}"
        help_ = did_you_mean(
            inside, files, "restore it, e.g. from version control, or correct the path", similarity=0.85
        )
        raise KeymintError(message, where=where, help=help_, code="file-missing")
    return files[inside]


def normal_path(path: str, where: Origin) -> str:
    """Normalize a relative path.

    Raises:
        KeymintError: the path is absolute or contains ``..``.
    """
    if (normal := _normal(path)) is None:
        message = f"the path {path!r} is not a plain relative path"
        help_ = "write a path inside the same folder, without '..' or a leading '/'"
        raise KeymintError(message, where=where, help=help_, code="path-outside")
    return normal


@lru_cache
def _normal(path: str) -> str | None:
    if path.startswith("/") or ".." in path.split("/") or "\\" in path or not path.isprintable():
        return None
    return posixpath.normpath(path)
