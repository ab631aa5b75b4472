# SPDX-License-Identifier: Apache-2.0
"""Tunables (variables of a policy) in lexical scopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import partial

from comarmor.errors import ComArmorError, Origin, Spot
from comarmor.language.attachments import MOST_VALUES, TunableReference, Value, expand, strip
from comarmor.language.attachments import parse as parse_attachment
from comarmor.language.syntax import Tunable
from comarmor.text import did_you_mean
from comarmor.values import dataclass

MOST_CHARACTERS = 32 * 2**20
"""The most characters of all expanded expressions of a policy."""


_Key = tuple[Spot, str]
"""Place and name of a tunable."""


@dataclass(slots=True)
class ExpansionBudget:
    """The characters that a policy's expanded expressions use, and its used and unused tunables.

    A tunable of a file that is included several times is counted once.
    """

    used: int = 0
    unused_tunables: dict[_Key, Tunable] = field(default_factory=dict)
    used_tunables: set[_Key] = field(default_factory=set)

    def declare(self, tunable: Tunable) -> None:
        """Record the declaration of a tunable."""
        key = tunable.where.spot, tunable.name
        if key not in self.used_tunables:
            self.unused_tunables.setdefault(key, tunable)

    def use(self, tunable: Tunable) -> None:
        """Record a use of a tunable."""
        key = tunable.where.spot, tunable.name
        self.used_tunables.add(key)
        self.unused_tunables.pop(key, None)


@dataclass(slots=True)
class TunableScope:
    """The scope of a ``<profiles>`` or ``<profile>`` element.

    Attributes:
        budget: shared by the complete policy.
        outer: the enclosing scope.
        own: the tunables declared so far.
        passed: by name, a tunable of an enclosing scope that this scope had not declared, and the place of its first
            use.
    """

    budget: ExpansionBudget
    outer: TunableScope | None = None
    own: dict[str, Tunable] = field(default_factory=dict)
    passed: dict[str, tuple[Tunable, Origin]] = field(default_factory=dict)

    def declare(self, name: str, values: Sequence[str], where: Origin) -> None:
        """Declare a tunable in this scope; from here on it hides tunables of the same name in enclosing scopes.

        Raises:
            ComArmorError: this scope has declared the name, or used an outer tunable of that name, or a value refers to
                the tunable itself, or is wrong.
        """
        if name in self.own:
            raise ComArmorError(
                f"the tunable @{{{name}}} is declared twice in this scope",
                where=where,
                help=f"the first declaration is at {self.own[name].where}",
                code="tunable",
            )
        if name in self.passed:
            outer, use = self.passed[name]
            raise ComArmorError(
                f"the tunable @{{{name}}} is declared after its use at {use}, which refers to the one "
                f"declared at {outer.where}",
                where=where,
                help="declare it above its use, or give it another name",
                code="tunable",
            )
        # Declared even if defective, so that its uses are not reported as well.
        self.own[name] = Tunable(name, (), where)
        expanded: dict[Value, None] = {}
        for value in values:
            pieces = parse_attachment(value)
            if TunableReference(name) in pieces:
                raise ComArmorError(f"the tunable @{{{name}}} refers to itself", where=where, code="tunable")
            expanded.update(dict.fromkeys(expand(pieces, partial(self.values, where=where))))
            if len(expanded) > MOST_VALUES:
                raise ComArmorError(f"the tunable has more than the {MOST_VALUES:,} values allowed", code="tunable")
        self.spend(expanded)
        self.own[name] = Tunable(name, tuple(expanded), where)
        self.budget.declare(self.own[name])

    def values(self, name: str, where: Origin) -> tuple[Value, ...]:
        """Return the values of a tunable for a use in a place.

        Raises:
            ComArmorError: it is not declared above, in this or an enclosing scope.
        """
        passed: list[TunableScope] = []
        scope: TunableScope | None = self
        while scope is not None:
            if tunable := scope.own.get(name):
                self.budget.use(tunable)
                for inner in passed:
                    inner.passed.setdefault(name, (tunable, where))
                return tunable.values
            passed.append(scope)
            scope = scope.outer
        known = dict.fromkeys(known for scope in passed for known in scope.own)
        raise ComArmorError(
            f"the tunable @{{{name}}} is unknown here",
            help=did_you_mean(name, known, "declare it with <tunable> above its use"),
            code="tunable",
        )

    def expand(self, text: str, where: Origin) -> tuple[Value, ...]:
        """Return the expansions of an attachment.

        Raises:
            ComArmorError: the notation is wrong, a tunable is unknown, or there are too many expansions.
        """
        pieces = parse_attachment(strip(text))
        expanded = dict.fromkeys(expand(pieces, partial(self.values, where=where)))
        self.spend(expanded)
        return tuple(expanded)

    def spend(self, values: dict[Value, None]) -> None:
        """Count the characters of expanded values.

        Raises:
            ComArmorError: the policy exceeds its limit.
        """
        self.budget.used += sum(len(piece) for value in values for piece in value)
        if self.budget.used > MOST_CHARACTERS:
            raise ComArmorError(
                f"the expanded tunables have more than the {MOST_CHARACTERS:,} characters allowed", code="tunable"
            )
