# SPDX-License-Identifier: Apache-2.0
"""Read one JSON5 document from bytes: with limits, no key twice, and the line of every value.

The document is read twice. A library decides whether it is JSON5 and which values it has; a scanner then finds the
lines and the doubled keys, which the library does not tell. A document that the two read differently is refused.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import pyjson5

from comarmor.text import lazy_regex, quote
from keymint.errors import KeymintError, Origin

FILE_BYTES = 64 * 2**20
"""Bytes of one file: a router's file of 1,000 enclaves has a few megabytes."""
DEPTH = 32
"""Nesting depth of objects and arrays; Zenoh's settings are nested 8 deep."""

_TOKEN = lazy_regex(
    r"""((?:[ \t\r\n]+|//[^\r\n]*|/\*.*?\*/)*)
        (?:(?P<mark>[{}\[\]:,])
        | (?P<text>"(?:[^"\\\r\n]|\\\r\n|\\.)*"|'(?:[^'\\\r\n]|\\\r\n|\\.)*')
        | (?P<word>[^\s{}\[\]:,"'/]+)
        | (?P<end>\Z))""",
    re.VERBOSE | re.DOTALL,
)
"""Space and comments, and what follows them: a mark, a text, another word, or the end of the document."""
# Other line ends and control characters end comments for some readers and not for others.
_REFUSED = lazy_regex("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\u2028\u2029]")
_PLAIN = lazy_regex(r"true|false|null|[+-]?(?:0[xX][0-9a-fA-F]+|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)")
"""The constants and numbers that all readers understand in the same way, if an integer has 64 bits at most."""
_NEAR = lazy_regex(r"near (\d+)")


Path = tuple[str | int, ...]
"""The keys and indices that lead from the root of a document to a value."""


def parse(content: bytes, name: str) -> tuple[Any, Mapping[Path, int]]:
    """Return a JSON5 document, and the line on which each value begins; for a member of an object, that of its key.

    Args:
        content: the document, UTF-8.
        name: path of the file as the user would type it, for messages.

    Raises:
        KeymintError: not well-formed, too large or too deep, a key occurs twice, or a number is not finite; with
            ``file:line``.
    """
    if len(content) > FILE_BYTES:
        raise _refused(f"the file has more than the {FILE_BYTES:,} bytes allowed", name, code="json5-limit")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise _refused("the file is not UTF-8", name, line, "save it as UTF-8") from None
    if odd := _REFUSED.search(text):
        line = text.count("\n", 0, odd.start()) + 1
        help_ = "remove it, or write it as an escape sequence"
        raise _refused(f"the character U+{ord(odd[0]):04X} is not allowed", name, line, help_)
    try:
        value = pyjson5.decode(text, DEPTH)
    except pyjson5.Json5NestingTooDeep:
        raise _refused(f"values are nested more than {DEPTH} deep", name, code="json5-limit") from None
    except pyjson5.Json5DecoderException as error:
        message = str(error.args[0]) if error.args else ""
        near = _NEAR.search(message)
        line = text.count("\n", 0, int(near[1])) + 1 if near else 0
        reason = re.sub(r"b'(\w+)'", r"\1", message.partition(" near ")[0]).removesuffix(" starting")
        raise _refused(f"not well-formed JSON5: {quote(reason)}", name, line) from None
    scanner = _Json5Scanner(text, name)
    own, theirs = (json.dumps(each, ensure_ascii=False) for each in (scanner.root(), value))
    if own != theirs:  # compared as texts, since 1 is not true, nor 1.0
        raise _refused("the file is not plain JSON5: readers may understand it differently", name)
    return value, scanner.lines


def _refused(message: str, name: str, line: int = 0, help_: str = "", code: str = "json5-syntax") -> KeymintError:
    return KeymintError(message, where=Origin(name, line), help=help_, code=code)


class _Json5Scanner:
    """Finds the line of each value in a document that a library has accepted.

    Args:
        text: the document.
        name: path of the file, for messages.

    Attributes:
        lines: the lines that were found.
    """

    def __init__(self, text: str, name: str) -> None:
        self.lines: dict[Path, int] = {}
        self._name = name
        self._line = 1
        self._parts = self._scan(text)

    def root(self) -> Any:
        """Return the value of the document.

        Raises:
            KeymintError: a key occurs twice, or a form that other readers may understand differently.
        """
        value = self._value((), *next(self._parts))
        if next(self._parts)[0] != "end":
            raise self._odd("more follows after the value")
        return value

    def _scan(self, text: str) -> Iterator[tuple[str, str]]:
        """Yield kind and text of each part; meanwhile the current line is that on which it begins."""
        position = 0
        while match := _TOKEN.match(text, position):
            position = match.end()
            space, kind = match[1], match.lastgroup or ""
            part = match[kind]
            self._line += space.count("\n")
            yield kind, part
            if kind == "text":
                self._line += part.count("\n")
        raise self._odd(f"{quote(text[position : position + 1])} is not expected here")

    def _value(self, path: Path, kind: str, part: str) -> Any:
        self.lines.setdefault(path, self._line)
        if kind == "text":
            return self._text(part)
        if part == "{":
            return self._members(path)
        if part == "[":
            return [self._value((*path, at), *each) for at, each in enumerate(self._each("]"))]
        if kind == "word" and _PLAIN.fullmatch(part):
            value = pyjson5.decode(part)
            if not isinstance(value, int) or -(2**63) <= value < 2**64:
                return value
        raise self._odd(f"{quote(part)} is not a value that all readers understand in the same way")

    def _members(self, path: Path) -> dict[str, Any]:
        members: dict[str, Any] = {}
        for kind, part in self._each("}"):
            line = self._line
            key = self._text(part) if kind == "text" else part
            if kind not in {"text", "word"} or (kind == "word" and "\\" in part):
                raise self._odd(f"{quote(part)} is not a key that all readers understand in the same way")
            if key in members:
                message = f"the key {quote(key)} occurs twice, first on line {self.lines[*path, key]}"
                raise _refused(message, self._name, line, "remove one of them", "json5-doubled")
            self.lines[*path, key] = line
            next(self._parts)  # the colon
            members[key] = self._value((*path, key), *next(self._parts))
        return members

    def _each(self, end: str) -> Iterator[tuple[str, str]]:
        """Yield kind and text of the part that begins each member or item, up to the mark at the end."""
        kind, part = next(self._parts)
        while part != end:
            yield kind, part
            kind, part = next(self._parts)
            if part == ",":
                kind, part = next(self._parts)

    def _text(self, part: str) -> str:
        return str(pyjson5.decode(part)) if "\\" in part else part[1:-1]

    def _odd(self, message: str) -> KeymintError:
        return _refused(message, self._name, self._line)
