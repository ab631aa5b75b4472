"""Tunables in force at a point of a policy: lexical scopes, as with variables of a programming language."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import MOST_VALUES, TunableReference, Value, expand, strip
from comarmor.language.attachments import parse as parse_attachment
from comarmor.language.syntax import Tunable
from comarmor.text import did_you_mean

MOST_CHARACTERS = 32 * 2**20
"""Most characters that all expressions of a policy together may have once its tunables are expanded."""


_Key = tuple[str, int, int, str]


@dataclass(slots=True)
class ExpansionBudget:
    """What the expressions of a policy have used: of :data:`MOST_CHARACTERS`, and of its tunables.

    A file that is included several times declares a tunable once.
    """

    used: int = 0
    unused_tunables: dict[_Key, Tunable] = field(default_factory=dict)
    used_tunables: set[_Key] = field(default_factory=set)

    def declared(self, tunable: Tunable) -> None:
        """Note a tunable that is declared."""
        if (key := _key(tunable)) not in self.used_tunables:
            self.unused_tunables.setdefault(key, tunable)

    def asked(self, tunable: Tunable) -> None:
        """Note a tunable that is used."""
        key = _key(tunable)
        self.used_tunables.add(key)
        self.unused_tunables.pop(key, None)


def _key(tunable: Tunable) -> _Key:
    return tunable.where.file, tunable.where.line, tunable.where.column, tunable.name


@dataclass(slots=True)
class TunableScope:
    """The tunables that a ``<profiles>`` or ``<profile>`` has declared so far, and the scope around it.

    Attributes:
        budget: what the whole policy has used.
        outer: the scope around this one.
        own: the tunables declared so far.
        passed: where a name was used first that this scope had not declared, so that it meant one of a scope around.
    """

    budget: ExpansionBudget
    outer: TunableScope | None = None
    own: dict[str, Tunable] = field(default_factory=dict)
    passed: dict[str, Origin] = field(default_factory=dict)

    def inner(self) -> TunableScope:
        """Return a new scope inside of this one."""
        return TunableScope(self.budget, self)

    def declare(self, name: str, values: Sequence[str], where: Origin) -> None:
        """Add a tunable to this scope; from here on it hides one of the same name in the scopes around.

        Raises:
            ComArmorError: this scope has one of that name, or used an outer one of that name, or a value refers to
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
            raise ComArmorError(
                f"the tunable @{{{name}}} is declared after its use at {self.passed[name]}, which would mean the one "
                f"declared at {self._around(name).where}",
                where=where,
                help="declare it above its use, or give it another name",
                code="tunable",
            )
        self.own[name] = Tunable(name, (), where)  # if it is defective, its uses are not reported as well
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
        self.budget.declared(self.own[name])

    def _around(self, name: str) -> Tunable:
        """Return the tunable of that name in the nearest scope around this one; there is one."""
        scope = self.outer
        while scope is not None and name not in scope.own:
            scope = scope.outer
        if scope is None:
            raise LookupError(name)
        return scope.own[name]

    def values(self, name: str, where: Origin) -> tuple[Value, ...]:
        """Return the values of a tunable that is used in a place.

        Raises:
            ComArmorError: it is not declared above, in this scope or one around it.
        """
        scope: TunableScope | None = self
        known: dict[str, None] = {}
        while scope is not None:
            if name in scope.own:
                self.budget.asked(scope.own[name])
                self._note_passed(name, scope, where)
                return scope.own[name].values
            known |= dict.fromkeys(scope.own)
            scope = scope.outer
        raise ComArmorError(
            f"the tunable @{{{name}}} is not known here",
            help=did_you_mean(name, known, "declare it above its use, with <tunable>"),
            code="tunable",
        )

    def _note_passed(self, name: str, found: TunableScope, where: Origin) -> None:
        """Note the use of a tunable in this scope and all around it up to the one that declares it."""
        scope: TunableScope | None = self
        while scope is not None and scope is not found:
            scope.passed.setdefault(name, where)
            scope = scope.outer

    def expand(self, text: str, where: Origin) -> tuple[Value, ...]:
        """Return what an attachment in a place stands for once its tunables are expanded.

        Raises:
            ComArmorError: the notation is wrong, a tunable is not known, or it stands for too much; without a place.
        """
        pieces = parse_attachment(strip(text))
        expanded = dict.fromkeys(expand(pieces, partial(self.values, where=where)))
        self.spend(expanded)
        return tuple(expanded)

    def spend(self, values: dict[Value, None]) -> None:
        """Count what was expanded.

        Raises:
            ComArmorError: it is more than a policy may have.
        """
        self.budget.used += sum(len(piece) for value in values for piece in value)
        if self.budget.used > MOST_CHARACTERS:
            raise ComArmorError(
                f"the expanded tunables have more than the {MOST_CHARACTERS:,} characters allowed", code="tunable"
            )
