# SPDX-License-Identifier: Apache-2.0
"""Decide requests by the rules of a subject: DENY overrides ALLOW, and a request that no rule allows is denied.

The rules that concern a permission are a row: names without wildcards in a dictionary, the other expressions by the
texts that they begin with. What a set of matching rules decides is computed once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

from comarmor.errors import ComArmorError, Reason
from comarmor.language.syntax import Decision
from comarmor.patterns.expression import literal, literal_prefix, matches, rule_matches_partition
from comarmor.rules import PARTS, PERMISSIONS, Effect, Rule, suffixes
from comarmor.text import did_you_mean, quoted
from comarmor.values import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Ruling:
    """What a policy decides, without the request.

    Attributes:
        effect: allow or deny.
        rules: the deciding rules, as in :class:`comarmor.language.syntax.Decision`.
        reason: one line for a person.
    """

    effect: Effect
    rules: tuple[Rule, ...]
    reason: Reason


class RuleIndex:
    """The rules of one subject, indexed by permission.

    Args:
        rules: the subject's rules, expanded for it; their order has no meaning.
    """

    __slots__ = ("_rows", "_rules")

    def __init__(self, rules: Sequence[Rule]) -> None:
        self._rules = rules
        self._rows: dict[tuple[str, str], Row] = {}

    def row(self, kind: str, permission: str) -> Row:
        """Return what the rules say about a permission.

        Args:
            kind: kind of the object.
            permission: a permission of that kind.

        Raises:
            ComArmorError: the kind or the permission is not known.
        """
        row = self._rows.get((kind, permission))
        if row is None:
            _known(kind, permission)
            if parts := PARTS.get((kind, permission)):
                row = _CompositeRow(kind, permission, [(self.row(*part[:2]), part[2]) for part in parts])
            else:
                row = _ElementaryRow(self._rules, kind, permission)
            self._rows[kind, permission] = row
        return row


class Row(ABC):
    """The rules of a subject that concern one permission."""

    __slots__ = ("kind", "permission")

    def __init__(self, kind: str, permission: str) -> None:
        self.kind = kind
        self.permission = permission

    @abstractmethod
    def ruling(self, name: str, partitions: Sequence[str] = ()) -> Ruling:
        """Decide about an object.

        Args:
            name: name of the object, any text.
            partitions: partitions of the endpoint; none means the default partition, whose name is empty. The
                request is allowed if it is allowed in each of them.
        """

    @abstractmethod
    def allowed(self, names: Iterable[str]) -> bytes:
        """Decide about many objects in the default partition, one byte each: 1 allowed, 0 denied."""

    def decision(self, name: str, partitions: Sequence[str] = ()) -> Decision:
        """Decide about an object, and return the request with the decision; arguments as of :meth:`ruling`."""
        ruling = self.ruling(name, partitions)
        effect, rules, reason = ruling.effect, ruling.rules, ruling.reason
        parts = self.parts(name, partitions)
        return Decision(self.kind, self.permission, name, tuple(partitions), effect, rules, reason, parts)

    def parts(self, name: str, partitions: Sequence[str]) -> tuple[Decision, ...]:
        """Return the decisions on the parts of a composite permission."""
        del name, partitions
        return ()


class _ElementaryRow(Row):
    """The rules that concern a permission without parts, also as a part of one of theirs."""

    __slots__ = ("_beginnings", "_exact", "_permitted", "_rules", "_rulings", "_wild")

    def __init__(self, rules: Sequence[Rule], kind: str, permission: str) -> None:
        super().__init__(kind, permission)
        self._rules = rules
        exact: dict[str, set[int]] = {}
        self._wild: list[tuple[int, str, str]] = []
        for at, rule in enumerate(rules):
            for suffix in suffixes(rule, kind, permission):
                for expression in rule.expressions:
                    text = literal(expression)
                    if text is None:
                        self._wild.append((at, expression, suffix))
                    else:
                        exact.setdefault(text + suffix, set()).add(at)
        self._exact = {name: tuple(sorted(positions)) for name, positions in exact.items()}
        self._beginnings = tuple({literal_prefix(expression) for _, expression, _ in self._wild})
        self._rulings: dict[tuple[int, ...], Ruling] = {}
        self._permitted: dict[tuple[int, ...], bool] = {}

    def _matching(self, name: str) -> tuple[int, ...]:
        """Return the positions of the rules that match a name."""
        found = self._exact.get(name, ())
        if not name.startswith(self._beginnings):
            return found
        wild = {
            at
            for at, expression, suffix in self._wild
            if name.endswith(suffix) and matches(expression, name.removesuffix(suffix))
        }
        return tuple(sorted(wild.union(found))) if wild else found

    def ruling(self, name: str, partitions: Sequence[str] = ()) -> Ruling:
        found = self._matching(name)
        if partitions:
            return self._ruled([self._rules[at] for at in found], partitions)
        ruling = self._rulings.get(found)
        if ruling is None:
            ruling = self._rulings[found] = self._ruled([self._rules[at] for at in found], ("",))
            self._permitted[found] = ruling.effect is Effect.ALLOW
        return ruling

    def allowed(self, names: Iterable[str]) -> bytes:
        permitted, matching = self._permitted, self._matching
        labels = bytearray()
        for name in names:
            allowed = permitted.get(matching(name))
            labels.append(self.ruling(name).effect is Effect.ALLOW if allowed is None else allowed)
        return bytes(labels)

    @staticmethod
    def _ruled(matching: Sequence[Rule], partitions: Iterable[str]) -> Ruling:
        """Return what the rules that match a name decide; that of the first partition that is denied."""
        allowing: dict[Rule, None] = {}
        for partition in partitions:
            shown = f" in partition {quoted(partition)}" if partition else ""
            here = [rule for rule in matching if rule_matches_partition(rule, partition)]
            if denying := tuple(rule for rule in here if rule.effect is Effect.DENY):
                return Ruling(Effect.DENY, denying, Reason(("the DENY rule", denying[0].origin, f" matches{shown}")))
            if not here:
                return Ruling(Effect.DENY, (), Reason((f"no ALLOW rule matches{shown}",)))
            allowing |= dict.fromkeys(here)
        deciding = tuple(allowing)
        reason = Reason(("the ALLOW rule", deciding[0].origin, " matches, and no DENY rule does"))
        return Ruling(Effect.ALLOW, deciding, reason)


class _CompositeRow(Row):
    """The rules that concern the parts of a composite permission; all parts must be allowed."""

    __slots__ = ("_parts",)

    def __init__(self, kind: str, permission: str, parts: Sequence[tuple[Row, str]]) -> None:
        super().__init__(kind, permission)
        self._parts = parts

    def ruling(self, name: str, partitions: Sequence[str] = ()) -> Ruling:
        rules: dict[Rule, None] = {}
        for row, suffix in self._parts:
            ruling = row.ruling(name + suffix, partitions)
            if ruling.effect is Effect.DENY:
                part = f"a part of it, {row.permission} {quoted(name + suffix)}, is denied: "
                return Ruling(Effect.DENY, ruling.rules, Reason((part, *ruling.reason.parts)))
            rules |= dict.fromkeys(ruling.rules)
        return Ruling(Effect.ALLOW, tuple(rules), Reason(("all parts of it are allowed",)))

    def allowed(self, names: Iterable[str]) -> bytes:
        listed = list(names)
        parts = [row.allowed(name + suffix for name in listed) for row, suffix in self._parts]
        return bytes(map(all, zip(*parts, strict=True)))

    def parts(self, name: str, partitions: Sequence[str]) -> tuple[Decision, ...]:
        return tuple(row.decision(name + suffix, partitions) for row, suffix in self._parts)


def _known(kind: str, permission: str) -> None:
    if kind not in PERMISSIONS:
        raise ComArmorError(
            f"unknown kind {quoted(kind)}, expected one of {', '.join(PERMISSIONS)}",
            help=did_you_mean(kind, PERMISSIONS),
            code="unknown-kind",
        )
    if permission not in PERMISSIONS[kind]:
        raise ComArmorError(
            f"unknown permission {quoted(permission)} of {kind}, expected one of {', '.join(PERMISSIONS[kind])}",
            help=did_you_mean(permission, PERMISSIONS[kind]),
            code="unknown-permission",
        )
