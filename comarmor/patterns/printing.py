# SPDX-License-Identifier: Apache-2.0
"""Write patterns as ``fnmatch`` expressions."""

from __future__ import annotations

from collections.abc import Iterable

from comarmor.patterns.glob import Glob
from comarmor.patterns.tokens import ANY, MAX_CODE, Bracket, Charset, Star, Token


def exact(glob: Glob, *, unescaped: str = "") -> str:
    r"""Return an expression that POSIX ``fnmatch`` reads as the pattern; some readers know no escapes.

    Args:
        glob: pattern.
        unescaped: members of sets that are written without ``\``, besides letters and digits; none that is special.
    """
    return "".join(_exact(token, unescaped) for token in glob)


def _exact(token: Token, unescaped: str) -> str:
    if isinstance(token, str):
        return "".join(f"\\{char}" if char in "*?[\\" else char for char in token)
    if isinstance(token, Star):
        return "*"
    if token == ANY:
        return "?"
    if not token.ranges:
        return "[b-a]"
    negated = token.ranges[-1][1] == MAX_CODE
    members = token.complement() if negated else token
    return f"[{'!' * negated}{_ranges(members, unescaped)}]"


def _ranges(members: Charset, unescaped: str) -> str:
    def end(code: int) -> str:
        char = chr(code)
        return char if char.isalnum() or (char in unescaped and char != "-") else f"\\{char}"

    parts = [end(low) if low == high else f"{end(low)}-{end(high)}" for low, high in members.ranges]
    if "-" in unescaped and r"\-" in parts:
        parts.remove(r"\-")
        parts.append("-")  # the last member of a set needs no escape
    return "".join(parts)


def canonical(tokens: Iterable[Token | Bracket]) -> str:
    """Return the canonical notation of an expression of a policy: with the fewest escapes, ``[^`` as ``[!``."""
    return "".join(
        _bracket(token)
        if isinstance(token, Bracket)
        else escape(token)
        if isinstance(token, str)
        else _exact(token, "")
        for token in tokens
    )


def escape(text: str) -> str:
    r"""Return an expression of a policy that matches exactly a text.

    Braces and white space are escaped as well as wildcards, because they have a meaning in attachments.
    """
    return "".join(f"\\{char}" if char in "*?[\\{}" or char.isspace() else char for char in text)


def _bracket(bracket: Bracket) -> str:
    members = (
        f"[:{member}:]"
        if isinstance(member, str)
        else _member(member[0]) + (f"-{_member(member[1])}" if member[0] != member[1] else "")
        for member in bracket.members
    )
    return f"[{'!' * bracket.negated}{''.join(members)}]"


def _member(char: str) -> str:
    return f"\\{char}" if char in "\\]![^-{}" or char.isspace() else char
