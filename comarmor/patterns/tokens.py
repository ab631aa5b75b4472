# SPDX-License-Identifier: Apache-2.0
r"""Split ``fnmatch`` expressions into tokens; the dialects are data.

All dialects share the notation of POSIX (IEEE Std 1003.1, 2.13; 1003.2-1992, B.6 and 3.13) without flags: ``*`` and
``?`` also match ``/`` and a leading ``.``, and ``[…]`` is a bracket expression. Characters are compared by code point,
classes are those of the C locale. Where POSIX leaves the meaning open, tokens follow the GNU C library: a ``[`` that is
never closed is an ordinary character, and ``[^…]`` means ``[!…]``. What POSIX calls undefined (:data:`Undefined`) is
an error in some dialects; the others read it as described there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import Literal, get_args

from comarmor.errors import ComArmorError
from comarmor.text import did_you_mean, lazy_regex
from comarmor.values import Data

MAX_CODE = 0x10FFFF
SPECIAL = lazy_regex(r"[*?\[\\]")
"""Characters that some dialect does not read as themselves."""


class PatternError(ComArmorError):
    """The text is not an expression of the dialect."""


Undefined = Literal["lone backslash", "unknown class", "collation", "empty range", "class in range"]
r"""Notation whose meaning POSIX leaves undefined, and what it means where it is no error.

``lone backslash``: one at the end, which escapes nothing: the expression matches nothing. ``unknown class``:
``[:name:]`` where no class has the name: ordinary characters. ``collation``: a collating element ``[.x.]`` or an
equivalence class ``[=x=]``: ordinary characters. ``empty range``: its ends are in the wrong order: it has no members.
``class in range``: a range that ends in a class: it ends in the ``[``.
"""


class Dialect(Data, eq=False):
    """How an implementation reads expressions.

    Attributes:
        escapes: a backslash escapes the next character; otherwise it is an ordinary character.
        negators: characters that negate a set if they come first in it.
        classes: sets may have classes such as ``[:alpha:]``.
        errors: undefined notation that raises :class:`PatternError`.
        closing_bracket_is_member: the ``]`` that ends a set is also a member of it and may begin a range, so that the
            set goes on; an unclosed set matches nothing.
    """

    escapes: bool = True
    negators: tuple[str, ...] = ("!", "^")
    classes: bool = True
    errors: frozenset[Undefined] = frozenset()
    closing_bracket_is_member: bool = False


COMARMOR = Dialect(errors=frozenset(get_args(Undefined)))
"""Expressions in policies: whatever POSIX leaves undefined is an error, because it only ever hides a mistake."""
POSIX = Dialect(errors=frozenset({"lone backslash", "unknown class", "collation"}))
"""``fnmatch`` with no flags; an error is what implementations read differently."""


class Star(Data, eq=False):
    """``*``: any number of characters. :data:`STAR` is the only one, so that comparing it takes no time."""

    def __reduce__(self) -> str:
        return "STAR"


class Charset(Data):
    """One character of a set.

    Attributes:
        ranges: closed ranges of code points, sorted; they neither touch nor overlap.
    """

    ranges: tuple[tuple[int, int], ...]

    def __contains__(self, char: str) -> bool:
        """Return whether a character is in the set."""
        code = ord(char)
        return any(low <= code <= high for low, high in self.ranges)

    def __len__(self) -> int:
        """Return the number of characters."""
        return sum(high - low + 1 for low, high in self.ranges)

    def chars(self) -> Iterator[str]:
        """Yield the characters in the order of their code points."""
        for low, high in self.ranges:
            yield from map(chr, range(low, high + 1))

    def complement(self) -> Charset:
        """Return the set of all other characters."""
        edges = [-1, *(edge for pair in self.ranges for edge in pair), MAX_CODE + 1]
        gaps = ((edges[i] + 1, edges[i + 1] - 1) for i in range(0, len(edges), 2))
        return Charset(tuple((low, high) for low, high in gaps if low <= high))

    def bracket_ranges(self) -> tuple[bool, tuple[tuple[int, int], ...]]:
        """Return whether a bracket expression of the set, which is not empty, is best negated, and its ranges.

        A set that extends to the last code point takes long to compile; its complement does not.
        """
        is_negated = self.ranges[-1][1] == MAX_CODE
        return is_negated, (self.complement() if is_negated else self).ranges

    def intersection(self, other: Charset) -> Charset:
        """Return the set of the characters that both have."""
        both = ((max(low, low2), min(high, high2)) for low, high in self.ranges for low2, high2 in other.ranges)
        return Charset(tuple((low, high) for low, high in both if low <= high))


def charset(ranges: Iterable[tuple[int, int]]) -> Charset:
    """Return the set of closed ranges of code points, given in any order; empty ranges are ignored."""
    merged: list[tuple[int, int]] = []
    for low, high in sorted(pair for pair in ranges if pair[0] <= pair[1]):
        if merged and low <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return Charset(tuple(merged))


def distinct_letters(singles: set[str], sets: Sequence[Charset], preferred: str = "") -> tuple[str, ...]:
    """Return one character of each class that single characters and sets distinguish, preferred ones first."""
    edges = {0}
    for low, high in (*((ord(char), ord(char)) for char in singles), *(pair for each in sets for pair in each.ranges)):
        edges.update((low, high + 1))
    classes: dict[tuple[object, ...], str] = {}
    for char in (*preferred, *map(chr, sorted(edge for edge in edges if edge <= MAX_CODE))):
        classes.setdefault((char if char in singles else None, *(char in each for each in sets)), char)
    return tuple(classes.values())


Token = str | Charset | Star
"""A part of a pattern: literal text, one character of a set, or any text."""

STAR = Star()
ANY = Charset(((0, MAX_CODE),))
"""``?``: any one character."""
_WILDCARDS: dict[str, Token] = {"*": STAR, "?": ANY}
NOTHING = Charset(())
"""A set without members: a pattern that contains it matches nothing."""

_DIGIT, _UPPER, _LOWER = (48, 57), (65, 90), (97, 122)
CLASSES = {
    "alnum": (_DIGIT, _UPPER, _LOWER),
    "alpha": (_UPPER, _LOWER),
    "blank": ((9, 9), (32, 32)),
    "cntrl": ((0, 31), (127, 127)),
    "digit": (_DIGIT,),
    "graph": ((33, 126),),
    "lower": (_LOWER,),
    "print": ((32, 126),),
    "punct": ((33, 47), (58, 64), (91, 96), (123, 126)),
    "space": ((9, 13), (32, 32)),
    "upper": (_UPPER,),
    "xdigit": (_DIGIT, (65, 70), (97, 102)),
}
"""The character classes in the C locale (IEEE Std 1003.1, 7.3.1)."""


class Bracket(Data):
    """A bracket expression as it is written.

    Attributes:
        negated: it matches the characters that are not members.
        members: names of classes, and ranges as pairs of their ends; a single character is a range of one.
    """

    negated: bool
    members: tuple[str | tuple[str, str], ...]

    def charset(self) -> Charset:
        """Return the characters that it matches."""
        classes = (CLASSES[member] for member in self.members if isinstance(member, str))
        ranges = ((ord(member[0]), ord(member[1])) for member in self.members if not isinstance(member, str))
        members = charset(chain(ranges, *classes))
        return members.complement() if self.negated else members


def tokenize(expression: str, dialect: Dialect) -> Iterator[Token | Bracket]:
    """Yield the tokens of an expression: single characters, ``?`` as :data:`ANY`, ``*``, and bracket expressions.

    Raises:
        PatternError: the expression contains undefined notation that is an error in the dialect.
    """
    index = 0
    while index < len(expression):
        token, index = next_token(expression, index, dialect)
        yield token


def next_token(expression: str, index: int, dialect: Dialect) -> tuple[Token | Bracket, int]:
    """Return the token that begins at an index, and the index after it.

    Raises:
        PatternError: as of :func:`tokenize`.
    """
    char = expression[index]
    index += 1
    if char == "\\" and dialect.escapes:
        if index < len(expression):
            return expression[index], index + 1
        if "lone backslash" in dialect.errors:
            raise _error("the expression ends with a lone '\\'", "write \\\\ for the character")
        return NOTHING, index
    if char == "[" and dialect.closing_bracket_is_member:
        return _open_bracket(expression, index, dialect) or (NOTHING, len(expression))
    if char == "[" and (bracket := _bracket(expression, index, dialect)):
        return bracket
    return _WILDCARDS.get(char, char), index


def _bracket(expression: str, index: int, dialect: Dialect) -> tuple[Bracket, int] | None:
    """Return the bracket expression after a ``[`` and the index after it; None if it is never closed."""
    negated = expression.startswith(dialect.negators, index)
    index += negated
    begin = index
    members: list[str | tuple[str, str]] = []
    error: PatternError | None = None  # raised only if the bracket is closed: else it is ordinary text
    while index < len(expression):
        if expression[index] == "]" and index > begin:
            if error:
                raise error
            return Bracket(negated, tuple(members)), index + 1
        if name := _class(expression, index, dialect):
            members.append(name)
            index += len(name) + 4
            continue
        if "collation" in dialect.errors and expression.startswith(("[.", "[="), index):
            error = error or _collation(expression[index : index + 2])
        first, index = _member(expression, index, dialect)
        last = first
        if expression.startswith("-", index) and expression[index + 1 : index + 2] not in ("", "]"):
            if "class in range" in dialect.errors and _class(expression, index + 1, dialect):
                raise _error("a character class cannot end a range", "escape the '-' as \\-")
            last, index = _member(expression, index + 1, dialect)
            if last < first and "empty range" in dialect.errors:
                error = error or _error(
                    f"the range {first}-{last} is empty", f"write {last}-{first}, or escape the '-' as \\-"
                )
        members.append((first, last))
    return None


_CLASS = lazy_regex(r"\[:([A-Za-z0-9]+):\]")
_COLLATION = lazy_regex(r"\[([.=])[^\]]*\1\]")


def _class(expression: str, index: int, dialect: Dialect) -> str | None:
    """Return the name of the class at an index, or None if there is none."""
    if not dialect.classes or expression[index] != "[":
        return None
    if "collation" in dialect.errors and _COLLATION.match(expression, index):
        raise _collation(expression[index : index + 2])
    match = _CLASS.match(expression, index)
    if match and match[1] in CLASSES:
        return match[1]
    if match and "unknown class" in dialect.errors:
        raise _error(
            f"unknown character class {match[0]}",
            did_you_mean(match[1].lower(), tuple(CLASSES)) or f"known are {', '.join(CLASSES)}",
        )
    return None


def _collation(mark: str) -> PatternError:
    return _error(
        f"'{mark}' begins a collating element or equivalence class, which names do not have",
        "list the characters, or escape the '[' as \\[",
    )


def _member(expression: str, index: int, dialect: Dialect) -> tuple[str, int]:
    """Return one end of a range and the index after it."""
    if dialect.escapes and expression[index] == "\\" and index + 1 < len(expression):
        index += 1
    return expression[index], index + 1


def _open_bracket(expression: str, index: int, dialect: Dialect) -> tuple[Bracket | Charset, int] | None:
    """Return a set whose closing bracket is a member of it and the index after it; None if it is never closed."""
    negated = expression.startswith(dialect.negators, index)
    index += negated
    if expression.startswith("]", index):  # a set without members; the bracket is then read again, as itself
        return (ANY, index) if negated else None
    members: list[str | tuple[str, str]] = []
    while index < len(expression):
        first = last = expression[index]
        index += 1
        if expression.startswith("-", index):
            last = expression[index + 1 : index + 2]
            if last in {"", "]"}:
                return None
            index += 2
        members.append((first, last))
        if first == "]":
            return Bracket(negated, tuple(members)), index
    return None


def _error(message: str, help_: str) -> PatternError:
    return PatternError(message, help=help_, code="expression")
