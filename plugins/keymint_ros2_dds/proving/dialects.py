"""Expressions of a permissions document as data, in the dialect of ``fnmatch`` of each implementation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType

from comarmor.patterns import glob
from comarmor.patterns.glob import ANY, STAR, Charset, Glob, Token, charset
from keymint_ros2_dds.decision import fnmatch
from keymint_ros2_dds.proving import octets

Reader = Callable[[str], Glob]
_NOTHING: Glob = (Charset(()),)


def _posix(expression: str) -> Glob:
    """``fnmatch`` with flags 0; an expression that ends in a backslash that escapes nothing matches nothing."""
    try:
        return glob.parse(expression)
    except glob.GlobError:
        glob.parse(expression + "\\")
        return _NOTHING


def _noescape(expression: str) -> Glob:
    """``fnmatch`` with FNM_NOESCAPE: a backslash is an ordinary character."""
    return glob.parse(expression.replace("\\", "\\\\"))


def _cyclone(expression: str) -> Glob:
    """``ac_fnmatch`` of Cyclone DDS 0.10; see :func:`keymint_ros2_dds.decision.fnmatch.cyclone`."""
    if fnmatch.is_plain(expression):
        return glob.parse(expression)
    tokens: list[Token] = []
    at = 0
    while at < len(expression):
        char = expression[at]
        at += 1
        if char == "*":
            tokens.append(STAR)
        elif char == "?":
            tokens.append(ANY)
        elif char == "[":
            found = _cyclone_set(expression, at)
            if found is None:
                return _NOTHING
            members, at = found
            tokens.append(members)
        else:
            tokens.append(char)
    return glob.normalise(tokens)


def _cyclone_set(expression: str, at: int) -> tuple[Charset, int] | None:
    """Return a set, of which the bracket that ends it is a member, and where it ends; None if it has no end."""
    negated = expression.startswith("!", at)
    at += negated
    if expression.startswith("]", at):  # a set without members; its bracket is then read a second time, as itself
        return (ANY, at) if negated else None
    ranges: list[tuple[int, int]] = []
    while at < len(expression):
        first = last = expression[at]
        at += 1
        if expression.startswith("-", at):
            last = expression[at + 1 : at + 2]
            if last in {"", "]"}:
                return None
            at += 2
        ranges.append((ord(first), ord(last)))
        if first == "]":
            members = charset(ranges)
            return (members.complement() if negated else members), at
    return None


READERS: Mapping[fnmatch.Dialect, Reader] = MappingProxyType(
    {fnmatch.posix: _posix, fnmatch.noescape: _noescape, fnmatch.cyclone: _cyclone}
)
"""How the expressions of each dialect become tokens."""


# Each model asks for each list of expressions, and for some of them in both directions.
@lru_cache(maxsize=64)
def read(expressions: tuple[str, ...], dialect: fnmatch.Dialect) -> tuple[Glob, ...]:
    """Return the patterns of some expressions over bytes, each once; see :mod:`keymint_ros2_dds.proving.octets`.

    Raises:
        GlobError: an expression means nothing.
    """
    if fnmatch.is_plain(whole := "".join(expressions)):
        if not whole.isascii():
            expressions = tuple(map(fnmatch.in_bytes, expressions))
        return tuple((text,) if text else () for text in dict.fromkeys(expressions))
    found = dict.fromkeys(map(READERS[dialect], expressions))
    return tuple(found) if whole.isascii() else tuple(dict.fromkeys(map(octets.of_glob, found)))
