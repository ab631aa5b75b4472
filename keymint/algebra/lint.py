"""What in a policy is in vain, or is likely not meant: rules without effect, and names that nothing has.

A rule is in vain only if it is so for every subject that it applies to: those that the policy names, and one example of
each pattern of subjects that its profiles match.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from keymint.algebra.attachments import Attachment, Attachments
from keymint.algebra.denials import may_matter
from keymint.algebra.lists import Key, allowed, keys, meet, names, patterns, universe
from keymint.algebra.profiles import quoted, unreachable
from keymint.algebra.similar import similar_names, similar_subjects
from keymint.algebra.subjects import rules_of, stand_ins, structure
from keymint.api import LoadedPolicy, Structure
from keymint.errors import Diagnostic, Origin, Severity, Spot
from keymint.ir import Effect, Rule
from keymint.keymake.algebra import disjoint
from keymint.keymake.glob import Glob
from keymint.proof import Block, Equal, implies

CODES: Mapping[str, str] = {
    "rule-shadowed": "An ALLOW rule allows nothing, because DENY rules deny all of it.",
    "rule-redundant": "What an ALLOW rule allows is allowed by other rules as well.",
    "deny-redundant": "What a DENY rule denies is denied by other rules as well.",
    "deny-nothing": "A DENY rule denies nothing that any rule allows.",
    "object-never": "No object can have a name that an expression matches.",
    "subject-never": "No subject can have a name that an attachment matches.",
    "profile-never": "A profile never applies together with the profiles around it.",
    "tunable-unused": "A tunable is declared, and nothing uses it.",
    "name-similar": "A name is nearly, but not quite, one that would fit.",
}
"""The findings of this room, each with one line that says what it means."""


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


@dataclass(slots=True)
class _Applied:
    """What the units say for one subject: by kind and permission, the patterns of each."""

    patterns: dict[Key, dict[tuple[_Unit, int], tuple[Glob, ...]]] = field(default_factory=lambda: defaultdict(dict))
    units: dict[_Unit, tuple[Rule, str, Origin]] = field(default_factory=dict)


def lint(policy: LoadedPolicy) -> list[Diagnostic]:
    """Return findings on a policy, by place.

    Args:
        policy: the policy.
    """
    written = structure(policy)
    named = policy.subjects()
    subjects = {subject: rules_of(policy, subject) for subject in (*named, *stand_ins(policy))}
    attachments = Attachments(written)
    found = [*_names(subjects, attachments), *(unreachable(written) if written else ())]
    found += _Vain(subjects, attachments, written).findings()
    found += similar_names({subject: subjects[subject] for subject in named}, attachments)
    found += similar_subjects(written) if written else ()
    return in_order(found)


def in_order(found: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return diagnostics by place, without doubles."""
    nowhere = Origin("")
    return sorted(
        dict.fromkeys(found),
        key=lambda each: ((each.where or nowhere).spot, each.code, each.message),
    )


def _names(subjects: Mapping[str, tuple[Rule, ...]], attachments: Attachments) -> Iterator[Diagnostic]:
    """Yield expressions that no object can match, whatever the subject."""
    verdicts: dict[tuple[Spot, str], tuple[bool, Rule, str]] = {}
    for subject, rules in subjects.items():
        for rule in rules:
            for expression in rule.expressions:
                key = (rule.origin.spot, expression)
                if key not in verdicts:
                    verdicts[key] = (_is_name(rule, expression), rule, subject)
    for (_, expression), (fine, rule, subject) in verdicts.items():
        if not fine:
            if rule.kind == "topic":
                help_ = "remove it"
            elif expression.startswith("/"):
                help_ = "segments are letters, digits and '_', do not begin with a digit, and none is empty"
            else:
                help_ = f"write {'/' + expression!r}: every ROS name begins with '/'"
            message = f"no object can be named as {expression!r} says in this {rule.effect} {rule.kind} rule"
            yield _warning("object-never", message, attachments.of(rule, subject)[expression].where, help_)


def _is_name(rule: Rule, expression: str) -> bool:
    return any(
        not isinstance(meet(key[0], allowed(pattern)), Equal)
        for key in keys(rule)
        for pattern in patterns(rule, expression, key)
    )


class _Vain:
    """Looks for rules without effect.

    Args:
        subjects: rules of each subject.
        attachments: where their expressions are written.
        written: the policy as it is written, if its type tells.
    """

    def __init__(
        self, subjects: Mapping[str, tuple[Rule, ...]], attachments: Attachments, written: Structure | None
    ) -> None:
        self._attachments = attachments
        self._written = written
        self._applied = {subject: _applied(rules, subject, attachments) for subject, rules in subjects.items()}
        self._by_unit: dict[_Unit, list[str]] = defaultdict(list)
        for subject, applied in self._applied.items():
            for unit in applied.units:
                self._by_unit[unit].append(subject)
        self._gone: set[_Unit] = set()

    def findings(self) -> Iterator[Diagnostic]:
        """Yield what is found, the expressions of a rule together if it is about all of them, else each by itself.

        An expression that no object can match is left out: it is said to be one.
        """
        found: dict[tuple[Spot, str], list[_Unit]] = defaultdict(list)
        # From the last: of two that say the same the later one goes; and what went is no reason for another to go.
        for unit in sorted(self._by_unit, key=lambda each: (each.place, each.attached, each.number), reverse=True):
            code = self._code(unit)
            if code:
                self._gone.add(unit)
                if self._can_match(unit):
                    found[unit.place, code].append(unit)
        for (place, code), units in found.items():
            if self._is_whole(place, units):
                yield self._said(code, units[::-1], whole=True)
                continue
            by_attachment: dict[Spot, list[_Unit]] = defaultdict(list)
            for unit in units[::-1]:
                by_attachment[unit.attached].append(unit)
            for together in by_attachment.values():
                yield self._said(code, together, whole=False)

    def _is_whole(self, place: Spot, units: Sequence[_Unit]) -> bool:
        return sum(unit.place == place and unit.effect is units[0].effect for unit in self._by_unit) == len(units)

    def _can_match(self, unit: _Unit) -> bool:
        """Tell whether an object can match an expression, for any of its subjects."""
        texts = dict.fromkeys(self._applied[subject].units[unit][:2] for subject in self._by_unit[unit])
        return any(_is_name(rule, expression) for rule, expression in texts)

    def _code(self, unit: _Unit) -> str:
        subjects = self._by_unit[unit]
        if unit.effect is Effect.DENY:
            if all(self._meets_nothing(subject, unit) for subject in subjects) and not self._may_matter(unit):
                return "deny-nothing"
            return "deny-redundant" if all(self._within(subject, unit, Effect.DENY) for subject in subjects) else ""
        if all(self._within(subject, unit, Effect.DENY) for subject in subjects):
            return "rule-shadowed"
        return "rule-redundant" if all(self._within(subject, unit, Effect.ALLOW) for subject in subjects) else ""

    def _own(self, subject: str, unit: _Unit) -> Iterator[tuple[Key, tuple[Glob, ...]]]:
        for key, by_unit in self._applied[subject].patterns.items():
            for (each, _), found in by_unit.items():
                if each == unit:
                    yield key, found

    def _others(self, subject: str, key: Key, unit: _Unit, effect: Effect, *, gone: bool = False) -> Iterator[Glob]:
        for (each, _), found in self._applied[subject].patterns[key].items():
            if each != unit and each.effect is effect and (gone or each not in self._gone):
                yield from found

    def _within(self, subject: str, unit: _Unit, effect: Effect) -> bool:
        """Tell whether other rules of an effect are about all that an expression is about."""
        for key, found in self._own(subject, unit):
            others = tuple(self._others(subject, key, unit, effect))
            for pattern in found:
                near = tuple(other for other in others if not disjoint(other, pattern))
                if not near:
                    return False
                mine = (*(block for block in names(key[0]) if not block.allows), Block(True, (pattern,)))
                if not isinstance(implies(mine, (Block(True, near),), universe(key[0])), Equal):
                    return False
        return True

    def _meets_nothing(self, subject: str, unit: _Unit) -> bool:
        """Tell whether no rule allows anything of what an expression denies."""
        for key, found in self._own(subject, unit):
            # Also what is said to be shadowed: it may be so by this one.
            others = tuple(self._others(subject, key, unit, Effect.ALLOW, gone=True))
            for pattern in found:
                near = tuple(other for other in others if not disjoint(other, pattern))
                if near and not isinstance(meet(key[0], allowed(pattern), (Block(True, near),)), Equal):
                    return False
        return True

    def _may_matter(self, unit: _Unit) -> bool:
        """Tell whether a denial may matter to a subject that is no example."""
        if self._written is None:
            return False
        applied = (self._applied[subject].units[unit] for subject in self._by_unit[unit])
        found = {self._attachments.clause(rule, Attachment(where, unit.number)) for rule, _, where in applied}
        return any(may_matter(self._written, *each) for each in found if each is not None)

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
        return _warning(code, f"{about} ({held}) {said}", rule.origin if whole else attached, helps[code])

    def _by(self, units: Iterable[_Unit], effect: Effect) -> str:
        """Return the place of an expression of an effect that is about what others are about, in words."""
        for unit in units:
            subject = self._by_unit[unit][0]
            for key, found in self._own(subject, unit):
                for (other, _), theirs in self._applied[subject].patterns[key].items():
                    if other == unit or other.effect is not effect or other in self._gone:
                        continue
                    if any(not disjoint(one, pattern) for one in theirs for pattern in found):
                        where = self._applied[subject].units[other][2]
                        return f", e.g. at {where.alone()}"
        return ""


def _applied(rules: Sequence[Rule], subject: str, attachments: Attachments) -> _Applied:
    found = _Applied()
    for at, rule in enumerate(rules):
        place = rule.origin.spot
        written = attachments.of(rule, subject)
        for expression in rule.expressions:
            attachment = written[expression]
            unit = _Unit(place, rule.effect, attachment.where.spot, attachment.number)
            found.units.setdefault(unit, (rule, expression, attachment.where))
            for key in keys(rule):
                if about := patterns(rule, expression, key):
                    found.patterns[key][unit, at] = about
    return found


def _warning(code: str, message: str, where: Origin, help_: str) -> Diagnostic:
    return Diagnostic(code, Severity.WARNING, message, where, help_)
