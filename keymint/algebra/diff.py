"""Two policies compared by meaning: what each subject gains and loses, over all names there are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from keymint.algebra.lists import (
    Key,
    allowed,
    conjunction,
    is_composite,
    keys,
    listed,
    meet,
    patterns,
    shown,
    universe,
    word,
)
from keymint.algebra.subjects import examples, only, structure
from keymint.api import LoadedPolicy
from keymint.errors import Origin
from keymint.ir import PERMISSIONS, Effect, Rule
from keymint.keymake.algebra import TooComplexError, covers, disjoint, intersection
from keymint.keymake.composites import parts
from keymint.keymake.glob import EVERYTHING, Glob, parse, surround
from keymint.proof import Block, DecisionList, Equal, Unknown, Witness, difference


@dataclass(frozen=True, slots=True)
class Change:
    """Objects on which a subject gains, or loses, a permission.

    Attributes:
        gains: the newer policy allows what the older does not; else the other way round.
        kind: kind of the objects.
        permission: the permission.
        pattern: expression of the objects, with the partition if it is not the default one.
        whole: all that the pattern matches changes; else some of it was so before, or is denied.
        example: the shortest name that changes; empty if that was not decided.
        where: the rule that allows it.
        unknown: why it was not decided; empty if it was.
    """

    gains: bool
    kind: str
    permission: str
    pattern: str
    whole: bool
    example: str
    where: Origin
    unknown: str = ""


@dataclass(frozen=True, slots=True)
class Changed:
    """What changed for a subject.

    Attributes:
        subject: the subject.
        like: the pattern of subjects that it stands for; empty for one that a policy names.
        before: the older policy has a profile that applies to it.
        after: the newer one has.
        changes: gains first.
    """

    subject: str
    like: str
    before: bool
    after: bool
    changes: tuple[Change, ...]


def diff(old: LoadedPolicy, new: LoadedPolicy) -> list[Changed]:
    """Return what changed between two policies, by subject; subjects without a change are left out.

    Subjects are those that either policy names, and examples of each pattern of subjects that profiles match.
    """
    named = sorted({*old.subjects(), *new.subjects()})
    written = [each for policy in (old, new) if (each := structure(policy))]
    like = examples(written, named)
    changed: list[Changed] = []
    told: set[tuple[str, bool]] = set()
    for subject in (*named, *like):
        before, after = old.rules(subject), new.rules(subject)
        mine, theirs = (each.rules if each else () for each in (before, after))
        changes = () if _same(mine, theirs) else tuple(changes_of(mine, theirs))
        if subject in like:
            # Of several examples of a pattern, one that gains, and one that changes at all.
            key = (like[subject], any(change.gains for change in changes))
            if not changes or key in told:
                continue
            told |= {key, (like[subject], False)}
        if changes or (before is None) is not (after is None):
            changed.append(Changed(subject, like.get(subject, ""), before is not None, after is not None, changes))
    return changed


def gains(found: Iterable[Changed]) -> bool:
    """Tell whether a subject gains something, or may do so where that was not decided."""
    return any(change.gains or change.unknown for each in found for change in each.changes)


def changes_of(old: Sequence[Rule], new: Sequence[Rule]) -> Iterator[Change]:
    """Yield what a subject gains and loses when its rules change, gains first."""
    for is_gain, before, after in ((True, old, new), (False, new, old)):
        composite = [
            found
            for kind, held in PERMISSIONS.items()
            for permission in held
            if is_composite(kind, permission)
            for found in _composite(before, after, kind, permission)
        ]
        explained: dict[Key, list[Glob]] = {}
        for kind, permission, pattern, *_ in composite:
            pieces = [((of, part), surround("", pattern, suffix)) for of, part, suffix in parts(kind, permission)]
            if all(_is_whole(key[0], piece, listed(before, key), listed(after, key)) for key, piece in pieces):
                for key, piece in pieces:
                    explained.setdefault(key, []).append(piece)
        elementary = [
            found
            for kind, held in PERMISSIONS.items()
            for permission in held
            if not is_composite(kind, permission)
            for found in _elementary(before, after, (kind, permission))
            if not any(covers(outer, found[2]) for outer in explained.get((kind, permission), ()))
        ]
        for kind, permission, pattern, example, whole, where, unknown in (*elementary, *composite):
            told = word(kind, example)
            yield Change(is_gain, kind, permission, shown(kind, pattern), whole, told, where, unknown)


_Found = tuple[str, str, Glob, str, bool, Origin, str]
"""Kind, permission, pattern, example, whether all of the pattern changes, the rule that allows it, and why unknown."""


def _elementary(before: Sequence[Rule], after: Sequence[Rule], key: Key) -> list[_Found]:
    """Return what rules allow of a kind and permission without parts that earlier ones do not."""
    old, new = listed(before, key), listed(after, key)
    if isinstance(difference(old, new, universe=universe(key[0])), Equal):
        return []
    denied = tuple(dict.fromkeys(pattern for block in old if not block.allows for pattern in block.patterns))
    found: list[_Found] = []
    for rule in after:
        if rule.effect is not Effect.ALLOW or key not in keys(rule):
            continue
        for expression in rule.expressions:
            for pattern in patterns(rule, expression, key):
                found += _of_pattern(pattern, old, new, denied, key, rule.origin)
    return _largest(found)


def _of_pattern(
    pattern: Glob, old: DecisionList, new: DecisionList, denied: tuple[Glob, ...], key: Key, where: Origin
) -> Iterator[_Found]:
    """Yield what of a pattern is allowed now and was not: what was denied, and what nothing allowed."""
    kind, permission = key
    mine = only(pattern, new)
    unspoken: DecisionList = (*(block for block in old if not block.allows), *_flipped(old)[1:])
    outcome = meet(kind, mine, unspoken)
    if not isinstance(outcome, Equal):
        whole = not any(not disjoint(pattern, each) for each in denied) and _is_whole(kind, pattern, old, new)
        yield _found(key, pattern, outcome, whole, where)
    for each in denied:
        try:
            pieces = intersection(pattern, each)
        except TooComplexError:
            pieces = (pattern,)
        for piece in pieces:
            outcome = meet(kind, allowed(piece), allowed(each), mine)
            if not isinstance(outcome, Equal):
                yield _found((kind, permission), piece, outcome, _is_whole(kind, piece, old, new), where)


def _composite(before: Sequence[Rule], after: Sequence[Rule], kind: str, permission: str) -> list[_Found]:
    """Return what rules allow of a permission with parts, all of them, that earlier rules do not."""
    candidates = {
        pattern: rule.origin
        for rule in reversed(after)
        if rule.effect is Effect.ALLOW and rule.kind == kind and permission in rule.permissions
        for expression in rule.expressions
        for pattern in (parse(expression),)
    }
    if not candidates:
        return []
    old, new = conjunction(before, kind, permission), conjunction(after, kind, permission)
    found: list[_Found] = []
    for pattern, where in candidates.items():
        outcomes = [meet(kind, allowed(pattern), *new, _flipped(part)) for part in old]
        outcome = _shortest(outcomes)
        if outcome is not None:
            had = not isinstance(meet(kind, allowed(pattern), *old), Equal)
            lacks = any(not isinstance(meet(kind, allowed(pattern), _flipped(part)), Equal) for part in new)
            found.append(_found((kind, permission), pattern, outcome, not had and not lacks, where))
    return _largest(found)


def _shortest(outcomes: Sequence[Equal | Witness | Unknown]) -> Witness | Unknown | None:
    witnesses = [each for each in outcomes if isinstance(each, Witness)]
    if witnesses:
        return min(witnesses, key=lambda each: (len(each.word), each.word))
    return next((each for each in outcomes if isinstance(each, Unknown)), None)


def _found(key: Key, pattern: Glob, outcome: Witness | Unknown, whole: bool, where: Origin) -> _Found:
    if isinstance(outcome, Unknown):
        return (*key, pattern, "", False, where, outcome.reason)
    return (*key, pattern, outcome.word, whole, where, "")


def _is_whole(kind: str, pattern: Glob, old: DecisionList, new: DecisionList) -> bool:
    """Tell whether the older list refuses, and the newer one permits, all that a pattern matches."""
    refused_before = meet(kind, allowed(pattern), old)
    refused_now = meet(kind, allowed(pattern), _flipped(new))
    return isinstance(refused_before, Equal) and isinstance(refused_now, Equal)


def _flipped(decided: DecisionList) -> DecisionList:
    """Return the list that permits exactly what another one refuses."""
    return (*(Block(not block.allows, block.patterns) for block in decided), Block(True, (EVERYTHING,)))


def _largest(found: Sequence[_Found]) -> list[_Found]:
    """Leave out what another pattern says as well."""
    kept: list[_Found] = []
    for at, one in enumerate(found):
        others = (*kept, *found[at + 1 :])
        if not any(covers(other[2], one[2]) and (other[4] or not one[4]) for other in others):
            kept.append(one)
    return kept


def _same(old: Sequence[Rule], new: Sequence[Rule]) -> bool:
    """Tell whether rules say the same, word by word, whatever their order and place."""
    return {_said(rule) for rule in old} == {_said(rule) for rule in new}


def _said(rule: Rule) -> tuple[object, ...]:
    return rule.effect, rule.kind, rule.permissions, frozenset(rule.expressions), frozenset(rule.partitions)
