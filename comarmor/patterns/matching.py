# SPDX-License-Identifier: Apache-2.0
"""Match patterns against names."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.tokens import ANY, MAX_CODE, Star

Matcher = Callable[[str], bool]


@lru_cache(maxsize=1 << 14)
def matcher(glob: Glob) -> Matcher:  # noqa: PLR0911 - one for each shape
    """Return a function that tells whether a pattern matches a name, in polynomial time."""
    if (text := literal(glob)) is not None:
        return text.__eq__
    match glob:
        case (Star(),):
            return lambda _: True
        case (str(head), Star()):
            return lambda name: name.startswith(head)
        case (Star(), str(tail)):
            return lambda name: name.endswith(tail)
        case (Star(), str(text), Star()):
            return lambda name: text in name
        case (str(head), Star(), str(tail)):
            shortest = len(head) + len(tail)
            return lambda name: len(name) >= shortest and name.startswith(head) and name.endswith(tail)
    expression = re.compile(regex(glob), re.DOTALL)
    return lambda name: expression.fullmatch(name) is not None


def matches(glob: Glob, name: str) -> bool:
    """Return whether a pattern matches a name."""
    return matcher(glob)(name)


def regex(glob: Glob) -> str:
    """Return a regular expression for :func:`re.fullmatch` with :data:`re.DOTALL`, which needs polynomial time.

    Between two ``*`` there is text of a fixed length. Its leftmost match is as good as any other, so that the search
    for it can be an atomic group. Without these groups ``*a*a*a*b`` needs exponential time.
    """
    steps = [""]
    for token in glob:
        if isinstance(token, Star):
            steps.append("")
        elif isinstance(token, str):
            steps[-1] += re.escape(token)
        elif not token.ranges:
            steps[-1] += "(?!)"
        elif token == ANY:
            steps[-1] += "."
        else:
            # A set that extends to the last code point takes long to compile; its complement does not.
            negated = token.ranges[-1][1] == MAX_CODE
            ranges = (token.complement() if negated else token).ranges
            members = "".join(rf"\U{low:08x}-\U{high:08x}" for low, high in ranges)
            steps[-1] += f"[{'^' * negated}{members}]"
    if len(steps) == 1:
        return steps[0]
    return steps[0] + "".join(f"(?>.*?{step})" for step in steps[1:-1]) + ".*" + steps[-1]
