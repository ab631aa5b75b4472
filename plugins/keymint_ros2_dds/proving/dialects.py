# SPDX-License-Identifier: Apache-2.0
"""Read the expressions of a permissions document as patterns, in the dialect of each implementation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache

from comarmor.patterns.glob import Glob, parse
from comarmor.patterns.tokens import Dialect, Undefined
from keymint_ros2_dds.decision import fnmatch_dialects
from keymint_ros2_dds.proving import octets


@cache
def _strict(dialect: Dialect) -> Dialect:
    """Return the dialect with errors for notation that implementations read differently."""
    return replace(dialect, errors=frozenset({Undefined.UNKNOWN_CLASS, Undefined.COLLATION}))


# Each model asks for each list of expressions, and for some of them in both directions.
@lru_cache(maxsize=64)
def read(expressions: tuple[str, ...], dialect: Dialect) -> tuple[Glob, ...]:
    """Return the distinct patterns of expressions over bytes; see :mod:`keymint_ros2_dds.proving.octets`.

    Raises:
        PatternError: an expression contains notation that implementations read differently.
    """
    joined = "".join(expressions)
    if fnmatch_dialects.is_plain(joined):
        if not joined.isascii():
            expressions = tuple(map(fnmatch_dialects.in_bytes, expressions))
        return tuple((text,) if text else () for text in dict.fromkeys(expressions))
    strict = _strict(dialect)
    patterns = dict.fromkeys([parse(expression, strict) for expression in expressions])
    return tuple(patterns) if joined.isascii() else tuple(dict.fromkeys(map(octets.of_glob, patterns)))
