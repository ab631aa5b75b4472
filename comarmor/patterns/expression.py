r"""What an attachment expression matches: POSIX ``fnmatch()`` with no flags.

The notation is that of IEEE Std 1003.2-1992, B.6 and 3.13: ``*`` and ``?`` also match ``/``, ``[…]`` is a bracket
expression, ``\`` escapes. Where POSIX leaves a meaning open, that of the GNU C library in the C locale holds: a
``[`` that is never closed is an ordinary character, and ``[^…]`` means ``[!…]``. Text is compared by code points.

What POSIX calls undefined and only ever hides a mistake is an error: a lone ``\`` at the end, an unknown character
class, collating elements, equivalence classes, and a range whose ends are in the wrong order.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from comarmor.errors import ComArmorError
from comarmor.text import did_you_mean

CLASSES = {
    "alnum": "0-9A-Za-z",
    "alpha": "A-Za-z",
    "blank": " \t",
    "cntrl": "\x00-\x1f\x7f",
    "digit": "0-9",
    "graph": "!-~",
    "lower": "a-z",
    "print": " -~",
    "punct": "!-/:-@[-`{-~",
    "space": "\t-\r ",
    "upper": "A-Z",
    "xdigit": "0-9A-Fa-f",
}
"""Character classes of the C locale (POSIX 1003.2-1992, 2.5.2.1), as ranges."""


@dataclass(frozen=True, slots=True)
class Literal:
    """One character that stands for itself."""

    char: str


@dataclass(frozen=True, slots=True)
class AnyChar:
    """``?``: any one character."""


@dataclass(frozen=True, slots=True)
class AnyText:
    """``*``: any text, also none."""


@dataclass(frozen=True, slots=True)
class Bracket:
    """A bracket expression.

    Attributes:
        negated: matches what is in none of the ranges.
        ranges: first and last character of each range; a single character is a range of one.
        text: the canonical notation, which begins with ``[`` or ``[!``.
    """

    negated: bool
    ranges: tuple[tuple[str, str], ...]
    text: str


Token = Literal | AnyChar | AnyText | Bracket


@lru_cache(maxsize=65536)
def parse(expression: str) -> tuple[Token, ...]:
    """Return the tokens of an expression.

    Raises:
        ComArmorError: the expression has no meaning in POSIX.
    """
    tokens: list[Token] = []
    at = 0
    while at < len(expression):
        token, at = next_token(expression, at)
        tokens.append(token)
    return tuple(tokens)


def next_token(expression: str, at: int) -> tuple[Token, int]:
    """Return the token that begins at an index, and the index behind it.

    Raises:
        ComArmorError: the expression has no meaning in POSIX.
    """
    char = expression[at]
    if char == "*":
        return AnyText(), at + 1
    if char == "?":
        return AnyChar(), at + 1
    if char == "\\":
        if at + 1 == len(expression):
            raise ComArmorError(
                "the expression ends with a lone '\\'", help="write \\\\ for the character", code="expression"
            )
        return Literal(expression[at + 1]), at + 2
    if char == "[":
        bracket = _bracket(expression, at)
        if bracket is not None:
            return bracket
    return Literal(char), at + 1


def _bracket(expression: str, start: int) -> tuple[Bracket, int] | None:
    """Return the bracket expression that begins at an index, or None when it is never closed."""
    end = _end_of_bracket(expression, start)
    if end is None:
        if _CLASS_ENDS_RANGE.search(expression, start):
            raise ComArmorError(_NO_RANGE, help="escape the '-' as \\-", code="expression")
        return None
    at = start + 1
    negated = expression[at] in "!^"
    at += negated
    ranges: list[tuple[str, str]] = []
    items: list[str] = []
    while at < end:
        named = _class(expression, at)
        if named is not None:
            ranges += _class_ranges(named)
            items.append(f"[:{named}:]")
            at += len(named) + 4
            continue
        first, at = _member(expression, at)
        last = first
        if at + 1 < end and expression[at] == "-":
            if _class(expression, at + 1) is not None:
                raise ComArmorError(_NO_RANGE, help="escape the '-' as \\-", code="expression")
            last, at = _member(expression, at + 1)
            if last < first:
                raise ComArmorError(
                    f"the range {first}-{last} is empty",
                    help=f"write {last}-{first}, or escape the '-' as \\-",
                    code="expression",
                )
        ranges.append((first, last))
        items.append(_escape_member(first) + (f"-{_escape_member(last)}" if last != first else ""))
    text = f"[{'!' if negated else ''}{''.join(items)}]"
    return Bracket(negated, tuple(ranges), text), end + 1


def _end_of_bracket(expression: str, start: int) -> int | None:
    """Return the index of the ``]`` that closes a bracket expression, or None."""
    at = start + 1
    if expression[at : at + 1] in ("!", "^"):
        at += 1
    first = True
    while at < len(expression):
        if expression[at] == "]" and not first:
            return at
        first = False
        closing = _named_end(expression, at)
        if closing is not None:
            at = closing
        else:
            at += 2 if expression[at] == "\\" else 1
    return None


_NAMED = re.compile(r"\[(?::([A-Za-z0-9]+):|([.=])[^\]]*\2)\]")
_CLASS_ENDS_RANGE = re.compile(r"-\[:[A-Za-z0-9]+:\]")
_NO_RANGE = "a character class cannot end a range"


def _named_end(expression: str, at: int) -> int | None:
    """Return the index behind ``[:…:]``, ``[.….]`` or ``[=…=]``, or None when there is none at this index."""
    named = _NAMED.match(expression, at) if expression[at] == "[" else None
    return named.end() if named else None


def _class(expression: str, at: int) -> str | None:
    """Return the name of the character class at an index, or None when there is none."""
    if expression[at : at + 2] in ("[.", "[="):
        raise ComArmorError(
            f"'{expression[at : at + 2]}' begins a collating element or equivalence class, which names do not have",
            help="list the characters, or escape the '[' as \\[",
            code="expression",
        )
    named = _NAMED.match(expression, at) if expression[at] == "[" else None
    if named is None:
        return None
    if named[1] not in CLASSES:
        raise ComArmorError(
            f"unknown character class [:{named[1]}:]",
            help=did_you_mean(named[1], CLASSES, f"known are {', '.join(CLASSES)}"),
            code="expression",
        )
    return named[1]


def _class_ranges(name: str) -> list[tuple[str, str]]:
    """Return the ranges of a character class of the C locale."""
    text = CLASSES[name]
    found: list[tuple[str, str]] = []
    at = 0
    while at < len(text):
        wide = text[at + 1 : at + 2] == "-"
        found.append((text[at], text[at + 2 if wide else at]))
        at += 3 if wide else 1
    return found


def _member(expression: str, at: int) -> tuple[str, int]:
    """Return one character of a bracket expression, and the index behind it."""
    if expression[at] == "\\":
        return expression[at + 1], at + 2
    return expression[at], at + 1


def _escape_member(char: str) -> str:
    return f"\\{char}" if char in "\\]![^-{}" or char.isspace() else char


def matches(expression: str, name: str) -> bool:
    """Tell whether an expression matches a whole name.

    Args:
        expression: ``fnmatch`` expression.
        name: any text.

    Raises:
        ComArmorError: the expression has no meaning in POSIX.
    """
    exact = literal(expression)
    return name == exact if exact is not None else _compiled(expression).fullmatch(name) is not None


@lru_cache(maxsize=65536)
def _compiled(expression: str) -> re.Pattern[str]:
    """Return an expression as a regular expression that needs at most polynomial time.

    Between two ``*`` stands text of fixed length, so that its leftmost match is as good as any other. The atomic groups
    say so: without them ``*a*a*a*b`` needs exponential time.
    """
    parts: list[str] = [""]
    for token in parse(expression):
        if isinstance(token, AnyText):
            parts.append("")
        else:
            parts[-1] += _regex(token)
    if len(parts) == 1:
        return re.compile(parts[0], re.DOTALL)
    first, *middle, last = parts
    return re.compile(first + "".join(f"(?>.*?{part})" for part in middle if part) + f".*{last}", re.DOTALL)


def _regex(token: Literal | AnyChar | Bracket) -> str:
    if isinstance(token, Literal):
        return re.escape(token.char)
    if isinstance(token, AnyChar):
        return "."
    ranges = "".join(f"{re.escape(first)}-{re.escape(last)}" for first, last in token.ranges)
    return f"[{'^' if token.negated else ''}{ranges}]"


@lru_cache(maxsize=65536)
def literal(expression: str) -> str | None:
    """Return the one name that an expression without wildcards matches, or None for one with wildcards.

    Raises:
        ComArmorError: the expression has no meaning in POSIX.
    """
    if not _SPECIAL.search(expression):
        return expression
    tokens = parse(expression)
    if all(isinstance(token, Literal) for token in tokens):
        return "".join(token.char for token in tokens if isinstance(token, Literal))
    return None


_SPECIAL = re.compile(r"[*?\[\\]")


def beginning(expression: str) -> str:
    """Return text that every name begins with that an expression matches: what stands before its first wildcard."""
    special = _SPECIAL.search(expression)
    return expression[: special.start()] if special else expression


def is_literal(expression: str) -> bool:
    """Tell whether an expression has no wildcards, so that it matches exactly one name.

    Raises:
        ComArmorError: the expression has no meaning in POSIX.
    """
    return literal(expression) is not None


def escape(text: str) -> str:
    r"""Return an expression that matches exactly a text.

    Beside the wildcards, braces and white space are escaped: they mean something in the attachments of a policy.
    """
    return "".join(f"\\{char}" if char in "*?[\\{}" or char.isspace() else char for char in text)


def unparse(tokens: Sequence[Token]) -> str:
    """Return the canonical notation of tokens: with the fewest escapes, ``[^`` written as ``[!``."""
    text: list[str] = []
    for token in tokens:
        if isinstance(token, Literal):
            text.append(escape(token.char))
        elif isinstance(token, AnyChar):
            text.append("?")
        elif isinstance(token, AnyText):
            text.append("*")
        else:
            text.append(token.text)
    return "".join(text)
