# SPDX-License-Identifier: Apache-2.0
"""The intermediate representation of Keymake, the compiler: rules without policy format and transport.

A policy plugin turns its format into these types, and a build plugin turns them into a transport's documents.
The rules are mandatory access control in which DENY overrides ALLOW: a request (kind, permission, object) is denied if
any DENY rule matches it, else allowed if any ALLOW rule does, else denied. The order of rules has no meaning.

Subjects of a kind (:func:`kind_of`) have the same rules but for the literal names in these, and for expressions with a
``*`` as their only wildcard. A compiler does its work once for a kind, and puts the texts of each member into the
result (docs/adr/0026-kinds.md).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, TypeVar, cast

from comarmor.patterns.tokens import SPECIAL
from comarmor.rules import Effect, Rule
from comarmor.values import Data

__all__ = ["Arguments", "Kind", "Rule", "SubjectRules", "kind_of", "once_of_kind"]

_T = TypeVar("_T")


class SubjectRules(Data):
    """All rules that apply to one subject.

    Args:
        subject: the subject's name, e.g. ``/robot1/talker``.
        read: the rules, or what returns them when they are first asked for; its errors are raised by :attr:`rules`.
        kind: what :func:`kind_of` will return for them, if that is known.
    """

    subject: str
    _read: tuple[Rule, ...] | Callable[[], tuple[Rule, ...]]
    _kind: tuple[Kind, Arguments] | None = None

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules, in the order of the policy, which has no meaning."""
        if not isinstance(self._read, tuple):
            object.__setattr__(self, "_read", self._read())
        return cast("tuple[Rule, ...]", self._read)

    @property
    def kind(self) -> tuple[Kind, Arguments]:
        """What :func:`kind_of` returns for the rules, computed once."""
        kind = self._kind
        if kind is None:
            kind = kind_of(self.rules)
            object.__setattr__(self, "_kind", kind)
        return kind

    def __eq__(self, other: object) -> bool:
        """Compare subjects and rules, whether these were read at once or are read now."""
        if not isinstance(other, SubjectRules):
            return NotImplemented
        return (self.subject, self.rules) == (other.subject, other.rules)

    def __hash__(self) -> int:
        """Return the hash of both."""
        return hash((self.subject, self.rules))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what another process makes of them: rules that were read."""
        return SubjectRules, (self.subject, self.rules)


KindRule = tuple[Effect, str, tuple[str, ...], tuple[str | int, ...], tuple[str, ...], bool]
"""Effect, kind, permissions, expressions, partitions and audit of a rule.

A number in place of an expression is that of an argument: as it is of a name, inverted (``~``) of one with a ``*``.
"""
Kind = tuple[KindRule, ...]
"""The rules of a subject with numbers in place of arguments."""
Arguments = tuple[str, ...]
"""The literal names of a subject's rules and the expressions with a ``*`` as their only wildcard.

Without duplicates, in the order of their first mention.
"""


def kind_of(rules: Iterable[Rule]) -> tuple[Kind, Arguments]:
    """Return the kind of a subject's rules, and the texts that the subject puts into it.

    Two subjects have the same rules exactly if kind and arguments are the same; where a rule is written does not count.

    Args:
        rules: the rules of a subject, in the order of the policy.
    """
    numbers: dict[str, int] = {}
    kind = []
    for rule in rules:
        expressions = [
            _numbered(text, numbers) if SPECIAL.search(text) else numbers.setdefault(text, len(numbers))
            for text in rule.expressions
        ]
        kind.append((rule.effect, rule.kind, rule.permissions, tuple(expressions), rule.partitions, rule.audit))
    return _shared(tuple(kind)), tuple(numbers)


def _numbered(text: str, numbers: dict[str, int]) -> str | int:
    """Return what stands for an expression with wildcards in a kind."""
    is_argument = text.count("*") == 1 and not SPECIAL.search(text.replace("*", ""))
    return ~numbers.setdefault(text, len(numbers)) if is_argument else text


_MOST_KINDS = 1 << 12


def once_of_kind(make: Callable[[Kind], _T]) -> Callable[[Kind], _T]:
    """Let a function of a kind make each result once; a decorator.

    Equal kinds are one object, by which results are known: to hash a kind costs as much as all else.
    """
    made: dict[int, tuple[Kind, _T]] = {}

    @functools.wraps(make)
    def known(kind: Kind) -> _T:
        found = made.get(id(kind))
        if found is None:
            if len(made) >= _MOST_KINDS:
                made.clear()
            found = made[id(kind)] = kind, make(kind)
        return found[1]

    return known


@lru_cache(maxsize=_MOST_KINDS)
def _shared(kind: Kind) -> Kind:
    """Return one object for equal kinds, so that they are compared, and kept, once."""
    return kind
