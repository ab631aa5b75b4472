# SPDX-License-Identifier: Apache-2.0
r"""Expressions as text: those of policies are read and matched, and patterns are written as ``fnmatch`` expressions.

Policies use the dialect :data:`comarmor.patterns.tokens.COMARMOR`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from comarmor.patterns.glob import Glob, Matcher, matcher, normalise
from comarmor.patterns.tokens import ANY, COMARMOR, SPECIAL, Bracket, Star, Token, tokenize
from comarmor.rules import Effect, Rule, suffixes


@lru_cache(maxsize=65536)
def parse(expression: str) -> tuple[Token | Bracket, ...]:
    """Return the tokens of an expression.

    Raises:
        PatternError: the expression contains notation that POSIX leaves undefined.
    """
    return tuple(tokenize(expression, COMARMOR))


def matches(expression: str, name: str) -> bool:
    """Return whether an expression matches a name.

    Raises:
        PatternError: as of :func:`parse`.
    """
    return _matcher(expression)(name)


@lru_cache(maxsize=65536)
def _matcher(expression: str) -> Matcher:
    return matcher(normalise(token.charset() if isinstance(token, Bracket) else token for token in parse(expression)))


@lru_cache(maxsize=65536)
def literal(expression: str) -> str | None:
    """Return the only name that an expression without wildcards matches, or None for one with wildcards.

    Raises:
        PatternError: as of :func:`parse`.
    """
    if not SPECIAL.search(expression):
        return expression
    tokens = parse(expression)
    texts = [token for token in tokens if isinstance(token, str)]
    return "".join(texts) if len(texts) == len(tokens) else None


def literal_prefix(expression: str) -> str:
    """Return the text before the first special character: every name that the expression matches begins with it."""
    special = SPECIAL.search(expression)
    return expression[: special.start()] if special else expression


def rule_matches(rule: Rule, kind: str, permission: str, name: str) -> bool:
    """Return whether a rule applies to an object, directly or because the object implements a composite permission.

    Args:
        rule: the rule.
        kind: kind of the object.
        permission: a permission that is not composite.
        name: name of the object.
    """
    return any(
        name.endswith(suffix) and any(matches(expression, name.removesuffix(suffix)) for expression in rule.expressions)
        for suffix in suffixes(rule, kind, permission)
    )


def rule_matches_partition(rule: Rule, partition: str) -> bool:
    """Return whether a rule applies to a partition; one without partitions allows the default one, and denies all."""
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return rule.effect is Effect.DENY or partition == ""


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

    def end(code: int) -> str:
        char = chr(code)
        return char if char.isalnum() or (char in unescaped and char != "-") else f"\\{char}"

    negated, ranges = token.bracket_ranges()
    parts = [end(low) if low == high else f"{end(low)}-{end(high)}" for low, high in ranges]
    if "-" in unescaped and r"\-" in parts:
        parts.remove(r"\-")
        parts.append("-")  # the last member of a set needs no escape
    return f"[{'!' * negated}{''.join(parts)}]"


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
    return "".join([f"\\{char}" if char in "*?[\\{}" or char.isspace() else char for char in text])


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
