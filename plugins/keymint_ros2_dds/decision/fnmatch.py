"""The dialects of ``fnmatch`` in which expressions of a permissions document are read, as regular expressions.

All compare bytes, as the vendors do in the C locale; text is turned into bytes as UTF-8 and each byte into one
character. None treats ``/`` or a leading period specially.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

Dialect = Callable[[str], str]
"""Turns a pattern (in bytes) into a regular expression (without anchors)."""

_NEVER = "(?!)"
_STAR = ".*"
_SPECIAL = frozenset("*?[\\")
_CLASSES = {
    "alnum": "0-9A-Za-z",
    "alpha": "A-Za-z",
    "blank": "\\x09\\x20",
    "cntrl": "\\x00-\\x1f\\x7f",
    "digit": "0-9",
    "graph": "\\x21-\\x7e",
    "lower": "a-z",
    "print": "\\x20-\\x7e",
    "punct": "\\x21-\\x2f\\x3a-\\x40\\x5b-\\x60\\x7b-\\x7e",
    "space": "\\x09-\\x0d\\x20",
    "upper": "A-Z",
    "xdigit": "0-9A-Fa-f",
}


def in_bytes(text: str) -> str:
    """Return a text with one character for each byte of its UTF-8 form."""
    return text if text.isascii() else text.encode("utf-8", "surrogateescape").decode("latin-1")


def is_plain(pattern: str) -> bool:
    """Tell whether a pattern matches itself and nothing else, in every dialect."""
    return _SPECIAL.isdisjoint(pattern)


@lru_cache(maxsize=65536)
def posix(pattern: str) -> str:
    """POSIX ``fnmatch`` with flags 0, as DDS Security 1.1 has it (9.4.1.3.2.3.2.1): ``\\`` escapes.

    What POSIX leaves open is as in glibc: ``[^`` negates as ``[!`` does, an unclosed ``[`` is an ordinary character.
    """
    return _translate(pattern, escapes=True)


@lru_cache(maxsize=65536)
def noescape(pattern: str) -> str:
    """Fast DDS: ``fnmatch(…, FNM_NOESCAPE)`` of the C library; ``\\`` is an ordinary character."""
    return _translate(pattern, escapes=False)


@lru_cache(maxsize=65536)
def cyclone(pattern: str) -> str:
    """Cyclone DDS's own matcher (``ac_fnmatch``).

    There is no escape; only ``!`` negates; and the bracket that ends a set is taken to be one of its members, so that
    it begins a range where ``-`` follows it.
    """
    out: list[str] = []
    at = 0
    while at < len(pattern):
        char = pattern[at]
        at += 1
        if char == "[":
            found = _cyclone_set(pattern, at)
            if found is None:
                return _NEVER
            piece, at = found
            out.append(piece)
        else:
            out.append(_one(char))
    return _joined(out)


def _cyclone_set(pattern: str, at: int) -> tuple[str, int] | None:
    """Return a set as a regular expression and where it ends; None for one that matches nothing, ever."""
    negated = pattern.startswith("!", at)
    at += negated
    if pattern.startswith("]", at):  # a set without members; its bracket is then read a second time, as itself
        return (".", at) if negated else None
    members: list[tuple[str, str]] = []
    ended = False
    while not ended:
        if at >= len(pattern):
            return None
        first = last = pattern[at]
        ended = first == "]"
        if pattern.startswith("-", at + 1):
            last = pattern[at + 2 : at + 3]
            if last in {"", "]"}:
                return None
            at += 2
        members.append((first, last))
        at += 1
    return _set(_ranges(members), negated=negated), at


def _translate(pattern: str, *, escapes: bool) -> str:
    out: list[str] = []
    at = 0
    while at < len(pattern):
        char = pattern[at]
        at += 1
        if char == "\\" and escapes:
            if at == len(pattern):
                return _NEVER
            out.append(re.escape(pattern[at]))
            at += 1
        elif char == "[" and (found := _bracket(pattern, at, escapes=escapes)) is not None:
            piece, at = found
            out.append(piece)
        else:
            out.append(_one(char))
    return _joined(out)


def _bracket(pattern: str, at: int, *, escapes: bool) -> tuple[str, int] | None:
    """Return a bracket expression as a regular expression and where it ends; None if it has no end."""
    negated = pattern[at : at + 1] in {"!", "^"}
    at += negated
    begin = at
    members: list[tuple[str, str]] = []
    classes = ""
    while True:
        if at >= len(pattern):
            return None
        if pattern[at] == "]" and at > begin:
            return _set(_ranges(members) + classes, negated=negated), at + 1
        end = pattern.find(":]", at + 2)
        if pattern.startswith("[:", at) and pattern[at + 2 : end] in _CLASSES:
            classes += _CLASSES[pattern[at + 2 : end]]
            at = end + 2
            continue
        first, at = _member(pattern, at, escapes=escapes)
        last = first
        if pattern.startswith("-", at) and pattern[at + 1 : at + 2] not in {"", "]"}:
            last, at = _member(pattern, at + 1, escapes=escapes)
        members.append((first, last))


def _member(pattern: str, at: int, *, escapes: bool) -> tuple[str, int]:
    if escapes and pattern[at] == "\\" and at + 1 < len(pattern):
        at += 1
    return pattern[at], at + 1


def _ranges(members: list[tuple[str, str]]) -> str:
    return "".join(f"\\x{ord(first):02x}-\\x{ord(last):02x}" for first, last in members if first <= last)


def _set(body: str, *, negated: bool) -> str:
    if not body:
        return "." if negated else _NEVER
    return f"[{'^' * negated}{body}]"


def _joined(pieces: list[str]) -> str:
    """Return pieces as one expression that is matched in linear time: what lies between two ``*`` is tried once.

    The first place where it matches is as good as any later one, so that nothing is lost by not trying those.
    """
    chunks = [""]
    for piece in pieces:
        if piece == _STAR:
            chunks.append("")
        else:
            chunks[-1] += piece
    if len(chunks) == 1:
        return chunks[0]
    first, *middle, last = chunks
    return first + "".join(f"(?>.*?{chunk})" for chunk in middle if chunk) + _STAR + last


def _one(char: str) -> str:
    if char == "*":
        return _STAR
    return "." if char == "?" else re.escape(char)
