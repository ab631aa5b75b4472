"""How a glob is written in a permissions document so that every vendor reads the same.

Cyclone DDS matches with a function of its own, Fast DDS with ``fnmatch(FNM_NOESCAPE)``. They agree on literals, ``*``
and ``?``. They disagree on bracket expressions, since for Cyclone DDS a bracket expression always holds ``]`` as
well, one that is followed by ``-`` is misread, and neither has escapes. The standard has: there, and for OpenDDS, a
backslash escapes, so that none is ever written. So small sets become alternatives, and the complement of a small set is
written as a bracket expression beside the alternative ``]``. Names are taken to be ASCII, as those of DDS topics are.
"""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import pairwise, product

from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.tokens import ANY, Charset, Star

MAX_ALTERNATIVES = 64
"""How many expressions one glob may become."""

_UNSAFE = re.compile(r"[^ -~]|[*?\[\\]")
_ASCII = Charset(((0, 127),))
_TRAPS = "\\]"


class InexpressibleError(Exception):
    """No spelling is read alike by all vendors; says why, and which vendors differ."""


@lru_cache(maxsize=1 << 14)
def spell(glob: Glob) -> tuple[str, ...]:
    r"""Return the expressions that together match exactly what a glob matches, on every vendor.

    Raises:
        InexpressibleError: there are none, e.g. for a name with a literal ``*``.
    """
    text = literal(glob)
    if text is not None:
        return (_literal(text),)
    choices = [_choices(token) for token in glob]
    count = 1
    for alternatives in choices:
        count *= len(alternatives)
        if count > MAX_ALTERNATIVES:
            raise InexpressibleError(f"a bracket expression stands for more than {MAX_ALTERNATIVES} alternatives")
    for before, following in pairwise(choices):
        if any(part.startswith("-") for part in following) and any(part.startswith("[") for part in before):
            raise InexpressibleError("a bracket expression is followed by '-', which Cyclone DDS misreads")
    found = tuple("".join(parts) for parts in product(*choices))
    for expression in found:
        _check_ends(expression)
    return found


def _literal(text: str) -> str:
    if found := _UNSAFE.search(text):
        char = found.group()
        if char in "*?[\\":
            raise InexpressibleError(
                f"the name has a literal {char!r}, for which the standard and the vendors have no common escape"
            )
        raise InexpressibleError(f"the name has the character {char!r}, which is not printable ASCII")
    _check_ends(text)
    return text


def _check_ends(text: str) -> None:
    if text != text.strip():
        raise InexpressibleError("the name begins or ends with a blank, which Cyclone DDS trims")


def _choices(token: str | Charset | Star) -> list[str]:
    if isinstance(token, Star):
        return ["*"]
    if isinstance(token, str):
        _literal(f"x{token}x")
        return [token]
    if token == ANY:
        return ["?"]
    if len(token) <= MAX_ALTERNATIVES:
        return [_literal(f"x{char}x")[1:-1] for char in token.chars()]
    excluded = token.complement().intersection(_ASCII)
    if len(excluded) > MAX_ALTERNATIVES or token.ranges[-1][1] != ANY.ranges[0][1]:
        raise InexpressibleError(
            f"a bracket expression holds more than {MAX_ALTERNATIVES} characters, and on Cyclone DDS ']' matches it too"
        )
    if unsafe := next((char for char in token.complement().chars() if not " " <= char <= "~"), None):
        raise InexpressibleError(f"a bracket expression leaves out {unsafe!r}, which is not printable ASCII")
    for char in _TRAPS:
        if char in excluded:
            raise InexpressibleError(f"a bracket expression leaves out {char!r}, which vendors read differently there")
    # Every member is a range, so that no character has a second meaning. Cyclone DDS leaves out the "]" as well.
    return ["[!" + "".join(f"{chr(low)}-{chr(high)}" for low, high in excluded.ranges) + "]", "]"]
