"""Rules without effect: what is allowed or denied elsewhere as well, and what nothing is left of.

Every question has a limit of steps, and so have all of them together; where it is reached the answer is unknown, which
is reported.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from comarmor.errors import Diagnostic, Origin, Severity, Spot
from comarmor.patterns.decision_lists import Block, Equal, ProofResult, Unknown
from comarmor.patterns.glob import Glob
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.proofs import implies
from comarmor.patterns.relations import TooComplexError
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.rules import Effect
from keymint.analysis.attachments import Attachment, AttachmentIndex
from keymint.analysis.deny_overlap import may_deny_something
from keymint.analysis.rule_lists import PermissionKey, allowed, keys, meet, names, patterns, universe
from keymint.analysis.unreachable_profiles import quoted
from keymint.api import PolicyStructure
from keymint.ir import Rule

UNIT = 300_000
"""Steps that the questions about one expression may take."""
TOGETHER = 20_000_000
"""Steps that all questions may take, and :data:`EACH` more for each expression."""
EACH = 1_000
MOST_PAIRS = 1_000_000
"""Pairs of a subject and a rule that are looked at."""


@dataclass(frozen=True, slots=True)
class _Unit:
    """An expression of a rule that is written at a place: the same one for every subject that it is expanded for.

    The place of its attachment and its number there identify the expression, since its text may differ from subject to
    subject.
    """

    place: Spot
    effect: Effect
    attached: Spot
    number: int


_Side = tuple[PermissionKey, Effect]


@dataclass(slots=True)
class _Applied:
    """What the units say for one subject: by kind, permission and effect, the patterns of each.

    Attributes:
        units: a rule of each unit, its expression, and where it is attached.
        own: the patterns of each unit, by kind and permission.
        near: all patterns with their units.
    """

    units: dict[_Unit, tuple[Rule, str, Origin]] = field(default_factory=dict)
    own: dict[_Unit, dict[PermissionKey, dict[Glob, None]]] = field(default_factory=dict)
    near: dict[_Side, PatternIndex[_Unit]] = field(default_factory=dict)


class RedundantRules:
    """Looks for rules without effect.

    Args:
        subjects: rules of each subject.
        attachments: where their expressions are written.
        written: the policy as it is written, if its type tells.
    """

    def __init__(
        self, subjects: Mapping[str, tuple[Rule, ...]], attachments: AttachmentIndex, written: PolicyStructure | None
    ) -> None:
        self._attachments = attachments
        self._written = written
        # Subjects with the very same rules are asked about once.
        alike: dict[tuple[int, ...], str] = {}
        for subject, rules in subjects.items():
            alike.setdefault(tuple(map(id, rules)), subject)
        chosen = alike.values()
        self._applied = {subject: _applied(subjects[subject], subject, attachments) for subject in chosen}
        self._by_unit: dict[_Unit, list[str]] = defaultdict(list)
        for subject, applied in self._applied.items():
            for unit in applied.units:
                self._by_unit[unit].append(subject)
        self._of_rule = Counter((unit.place, unit.effect) for unit in self._by_unit)
        self._gone: set[_Unit] = set()
        self._unknown: list[_Unit] = []

    def findings(self) -> Iterator[Diagnostic]:
        """Yield what is found, the expressions of a rule together if it is about all of them, else each by itself.

        An expression that no object can match is left out: it is reported as such.
        """
        found: dict[tuple[Spot, str], list[_Unit]] = defaultdict(list)
        with step_limit(TOGETHER + EACH * len(self._by_unit)):
            # From the last: of two that say the same the later one goes; and what went is no reason for another to go.
            for unit in sorted(self._by_unit, key=lambda each: (each.place, each.attached, each.number), reverse=True):
                code = self._asked(unit)
                if code:
                    self._gone.add(unit)
                    found[unit.place, code].append(unit)
        for (place, code), units in found.items():
            if self._of_rule[place, units[0].effect] == len(units):
                yield self._said(code, units[::-1], whole=True)
                continue
            by_attachment: dict[Spot, list[_Unit]] = defaultdict(list)
            for unit in units[::-1]:
                by_attachment[unit.attached].append(unit)
            for together in by_attachment.values():
                yield self._said(code, together, whole=False)
        yield from self._given_up()

    def _asked(self, unit: _Unit) -> str:
        """Return the finding on an expression, or an empty text; note it where that takes too many steps."""
        try:
            with step_limit(UNIT):
                code = self._code(unit)
                return code if code and self._can_match(unit) else self._set_aside(unit, code)
        except (StepLimitError, TooComplexError):
            self._unknown.append(unit)
            return ""

    def _set_aside(self, unit: _Unit, code: str) -> str:
        """Leave out an expression that no object can match from the reasons of others."""
        if code:
            self._gone.add(unit)
        return ""

    def _given_up(self) -> Iterator[Diagnostic]:
        """Yield a note on the first expression that was not decided about, and how many there are."""
        if self._unknown:
            unit = self._unknown[-1]
            rule, expression, where = self._applied[self._by_unit[unit][0]].units[unit]
            more = f", nor for {len(self._unknown) - 1:,} other expressions" if len(self._unknown) > 1 else ""
            yield Diagnostic(
                "lint-unknown",
                Severity.NOTE,
                f"it was not found out whether {expression!r} in this {rule.effect} {rule.kind} rule has an effect"
                f"{more}: it overlaps with others in too many ways",
                where,
                "use fewer expressions with wildcards for one subject, or lint parts of the policy",
            )

    def _can_match(self, unit: _Unit) -> bool:
        """Tell whether an object can match an expression, for any of its subjects."""
        texts = dict.fromkeys(self._applied[subject].units[unit][:2] for subject in self._by_unit[unit])
        return any(can_name_exist(rule, expression) for rule, expression in texts)

    def _code(self, unit: _Unit) -> str:
        subjects = self._by_unit[unit]
        if unit.effect is Effect.DENY:
            if all(self._meets_nothing(subject, unit) for subject in subjects) and not self._may_matter(unit):
                return "deny-nothing"
            return "deny-redundant" if all(self._within(subject, unit, Effect.DENY) for subject in subjects) else ""
        if all(self._within(subject, unit, Effect.DENY) for subject in subjects):
            return "rule-shadowed"
        return "rule-redundant" if all(self._within(subject, unit, Effect.ALLOW) for subject in subjects) else ""

    def _near(self, subject: str, key: PermissionKey, effect: Effect, pattern: Glob) -> Iterator[tuple[Glob, _Unit]]:
        index = self._applied[subject].near.get((key, effect))
        return iter(()) if index is None else index.meeting(pattern)

    def _within(self, subject: str, unit: _Unit, effect: Effect) -> bool:
        """Tell whether other rules of an effect are about all that an expression is about."""
        for key, found in self._applied[subject].own[unit].items():
            for pattern in found:
                others = self._near(subject, key, effect, pattern)
                near = tuple(dict.fromkeys(one for one, whose in others if whose != unit and whose not in self._gone))
                if not near:
                    return False
                mine = (*(block for block in names(key[0]) if not block.allows), Block(True, (pattern,)))
                if not _surely(implies(mine, (Block(True, near),), universe(key[0]))):
                    return False
        return True

    def _meets_nothing(self, subject: str, unit: _Unit) -> bool:
        """Tell whether no rule allows anything of what an expression denies."""
        for key, found in self._applied[subject].own[unit].items():
            for pattern in found:
                # Also what is reported as shadowed: this one may shadow it.
                near = tuple(dict.fromkeys(one for one, _ in self._near(subject, key, Effect.ALLOW, pattern)))
                if near and not _surely(meet(key[0], allowed(pattern), (Block(True, near),))):
                    return False
        return True

    def _may_matter(self, unit: _Unit) -> bool:
        """Tell whether a denial may matter to a subject that is no example."""
        if self._written is None:
            return False
        applied = (self._applied[subject].units[unit] for subject in self._by_unit[unit])
        found = {self._attachments.clause(rule, Attachment(where, unit.number)) for rule, _, where in applied}
        return any(may_deny_something(self._written, *each) for each in found if each is not None)

    def _said(self, code: str, units: Sequence[_Unit], *, whole: bool) -> Diagnostic:
        rule, _, attached = self._applied[self._by_unit[units[0]][0]].units[units[0]]
        texts = [self._applied[self._by_unit[unit][0]].units[unit][1] for unit in units]
        about = f"{'' if whole else f'{quoted(texts)} in '}this {rule.effect} {rule.kind} rule"
        held = ", ".join(rule.permissions)
        by = self._by(units, Effect.ALLOW if code == "rule-redundant" else Effect.DENY)
        said = {
            "rule-shadowed": f"allows nothing: DENY rules deny all of it{by}",
            "rule-redundant": f"adds nothing: all of it is allowed elsewhere{by}",
            "deny-redundant": f"adds nothing: all of it is denied elsewhere{by}",
            "deny-nothing": "denies nothing: no rule allows any of it",
        }[code]
        helps = {
            "rule-shadowed": "remove it, or narrow the DENY: a DENY wins over every ALLOW",
            "rule-redundant": "remove it, or narrow the other",
            "deny-redundant": "remove it, or narrow the other",
            "deny-nothing": "remove it, or mend its attachment: what nothing allows is denied anyway",
        }
        return warning(code, f"{about} ({held}) {said}", rule.origin if whole else attached, helps[code])

    def _by(self, units: Iterable[_Unit], effect: Effect) -> str:
        """Return the place of an expression of an effect that is about what others are about, in words."""
        for unit in units:
            subject = self._by_unit[unit][0]
            for key, found in self._applied[subject].own[unit].items():
                near = {other for pattern in found for _, other in self._near(subject, key, effect, pattern)}
                for other in self._applied[subject].units if near else ():
                    if other in near and other != unit and other not in self._gone:
                        return f", e.g. at {self._applied[subject].units[other][2].alone()}"
        return ""


def can_name_exist(rule: Rule, expression: str) -> bool:
    """Tell whether an object can have a name that an expression of a rule matches; True where that is not decided."""
    return any(
        not isinstance(meet(key[0], allowed(pattern)), Equal)
        for key in keys(rule)
        for pattern in patterns(rule, expression, key)
    )


def warning(code: str, message: str, where: Origin, help_: str) -> Diagnostic:
    """Return a finding."""
    return Diagnostic(code, Severity.WARNING, message, where, help_)


def _surely(outcome: ProofResult) -> bool:
    """Tell whether the answer to a question is yes.

    Raises:
        EffortError: it was not decided.
    """
    if isinstance(outcome, Unknown):
        raise StepLimitError(UNIT)
    return isinstance(outcome, Equal)


def _applied(rules: Sequence[Rule], subject: str, attachments: AttachmentIndex) -> _Applied:
    found = _Applied()
    sides: dict[_Side, list[tuple[Glob, _Unit]]] = defaultdict(list)
    for rule in rules:
        written = attachments.of(rule, subject)
        for expression in rule.expressions:
            attachment = written[expression]
            unit = _Unit(rule.origin.spot, rule.effect, attachment.where.spot, attachment.number)
            found.units.setdefault(unit, (rule, expression, attachment.where))
            own = found.own.setdefault(unit, {})
            for key in keys(rule):
                for pattern in patterns(rule, expression, key):
                    own.setdefault(key, {})[pattern] = None
                    sides[key, rule.effect].append((pattern, unit))
    found.near = {side: PatternIndex(items) for side, items in sides.items()}
    return found


_Rules = Mapping[str, tuple[Rule, ...]]


def within_bounds(subjects: Iterable[str], rules: Callable[[str], tuple[Rule, ...]]) -> tuple[_Rules, list[str]]:
    """Return the rules of subjects, and the subjects that there was no room for."""
    found: dict[str, tuple[Rule, ...]] = {}
    left_out: list[str] = []
    pairs = 0
    for subject in subjects:
        if pairs < MOST_PAIRS:
            found[subject] = rules(subject)
            pairs += len(found[subject])
        else:
            left_out.append(subject)
    return found, left_out
