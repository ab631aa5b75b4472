"""Reads the XML documents of profiles and packages: safely, strictly, and equal ones only once.

Many packages of a workspace hold equal documents. A document is therefore read without knowing its name, which is put
into the messages afterwards, and what is read is remembered by content.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Generic, TypeVar

from lxml import etree

from comarmor.data import locate
from comarmor.errors import Diagnostic, Origin
from comarmor.text import did_you_mean
from comarmor.xml import reader, schema
from keymint.errors import KeymintError

_T = TypeVar("_T")

_NAMELESS = "<document>"
_REMEMBERED = 256
"""Documents of one kind to remember: all that packages share, and few that only one of them has."""
_PLAIN = re.compile(r"[a-z_]+(\.[a-z_]+)*(/[a-z_]+(\.[a-z_]+)*)*")
"""The usual paths, which are in their normal form."""


class Reader(Generic[_T]):
    """Reads documents of one kind.

    Args:
        schema_name: name of the schema in ``schemas/keymint_ros/``, without its suffix.
        convert: turns a valid root element into immutable data; places in it know their line only.
    """

    def __init__(self, schema_name: str, convert: Callable[[etree._Element], _T]) -> None:
        self._schema = schema_name
        self._convert = convert
        self._remembered = lru_cache(maxsize=_REMEMBERED)(self._read)

    def __call__(self, content: bytes, name: str) -> _T:
        """Return what a document says.

        Args:
            content: the document.
            name: its path as the user would type it, for messages.

        Raises:
            KeymintError: it is not well-formed or not valid, with ``file:line`` of each defect.
        """
        try:
            return self._remembered(content)
        except KeymintError as error:
            raise KeymintError.of(_named(diagnostic, name) for diagnostic in error.diagnostics) from None

    def _read(self, content: bytes) -> _T:
        return self._convert(parse(content, _NAMELESS, self._schema))


def parse(content: bytes, name: str, schema_name: str = "") -> etree._Element:
    """Return the root element of a document, valid against a schema if one is given.

    Raises:
        KeymintError: it is not well-formed or not valid.
    """
    root = reader.parse(content, name)
    if schema_name:
        schema.validate(root, locate("keymint_ros", "schemas") / f"{schema_name}.xsd", name)
    return root


def _named(diagnostic: Diagnostic, name: str) -> Diagnostic:
    where = diagnostic.where
    return replace(diagnostic, where=Origin(name, where.line)) if where and where.file == _NAMELESS else diagnostic


def place(element: etree._Element) -> Origin:
    """Return where an element stands in the document that is being read."""
    return Origin(_NAMELESS, line(element))


def line(element: etree._Element) -> int:
    """Return the line of an element, from 1."""
    counted: int | None = element.sourceline  # type: ignore[assignment] # lxml-stubs say it is an ellipsis
    return counted or 0


def text(element: etree._Element | None) -> str | None:
    """Return the text of an element without the space around it, or None when there is no element."""
    return None if element is None else (element.text or "").strip()


def truth(element: etree._Element | None) -> bool | None:
    """Return the value of an ``xs:boolean``, or None when there is no element."""
    return None if element is None else text(element) in {"true", "1"}


def file_in(files: Mapping[str, bytes], path: str, where: Origin, space: str) -> bytes:
    """Return a file that a document names.

    Args:
        files: the files by path relative to their space.
        path: the path as the document says it.
        where: where the document says it.
        space: what the files are those of, for messages.

    Raises:
        KeymintError: the path leads out of the space, or there is no such file.
    """
    inside = confined(path, where)
    if inside not in files:
        raise KeymintError(
            f"there is no file {path!r} in the {space}",
            where=where,
            help=did_you_mean(inside, files, "create it, or correct the path"),
            code="file-missing",
        )
    return files[inside]


def confined(path: str, where: Origin) -> str:
    """Return a relative path in its normal form.

    Raises:
        KeymintError: it is absolute or has ``..``.
    """
    if _PLAIN.fullmatch(path):
        return path
    if path.startswith("/") or ".." in path.split("/") or "\\" in path or not path.isprintable():
        raise KeymintError(
            f"the path {path!r} is not a plain relative path",
            where=where,
            help="write a path inside the same folder, without '..' or a leading '/'",
            code="path-outside",
        )
    return posixpath.normpath(path)
