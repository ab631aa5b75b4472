# SPDX-License-Identifier: Apache-2.0
"""Kinds of subjects: subjects of a kind have the same rules but for the literal names in these.

A compiler does its work once for a kind, and puts the names of each member into the result (docs/adr/0026-kinds.md).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from comarmor.patterns.tokens import SPECIAL
from comarmor.rules import Effect
from keymint.ir import Rule

KindRule = tuple[Effect, str, tuple[str, ...], tuple[str | int, ...], tuple[str, ...], bool]
"""Effect, kind, permissions, expressions, partitions and audit of a rule; a number is that of an argument."""
Kind = tuple[KindRule, ...]
"""The rules of a subject with numbers in place of literal names."""
Arguments = tuple[str, ...]
"""The literal names of a subject's rules, without duplicates, in the order of their first mention."""


def kind_of(rules: Iterable[Rule]) -> tuple[Kind, Arguments]:
    """Return the kind of a subject's rules, and the names that the subject puts into it.

    Two subjects have the same rules exactly if kind and arguments are the same; where a rule is written does not count.

    Args:
        rules: the rules of a subject, in the order of the policy.
    """
    numbers: dict[str, int] = {}
    kind = []
    for rule in rules:
        expressions = tuple(
            text if SPECIAL.search(text) else numbers.setdefault(text, len(numbers)) for text in rule.expressions
        )
        kind.append((rule.effect, rule.kind, rule.permissions, expressions, rule.partitions, rule.audit))
    return _shared(tuple(kind)), tuple(numbers)


@lru_cache(maxsize=1 << 12)
def _shared(kind: Kind) -> Kind:
    """Return one object for equal kinds, so that they are compared, and kept, once."""
    return kind
