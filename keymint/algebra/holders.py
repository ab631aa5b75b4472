"""Who holds a permission: among all subjects there are, not only those that a policy names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from keymint.algebra.lists import (
    allowed,
    conjunction,
    keys,
    meet,
    patterns,
    text,
    without,
)
from keymint.algebra.subjects import EVERY, at_most, can_be, example, matching, rules_of, structure
from keymint.api import LoadedPolicy, Structure
from keymint.errors import Origin
from keymint.ir import Effect, Rule
from keymint.keymake.algebra import TooComplexError, intersection, matches
from keymint.keymake.composites import parts
from keymint.keymake.glob import STAR, Glob, literal, surround
from keymint.proof import Equal, Unknown, Witness


@dataclass(frozen=True, slots=True)
class Held:
    """A permission that a subject holds, or may hold.

    Attributes:
        subject: the subject; empty if none was found for certain.
        like: a pattern of subjects that it is one of; empty for a subject that was asked for or that a policy names.
        word: the shortest name that it holds it on; empty if none was found for certain.
        where: the rule that allows it.
        unknown: why it is not certain; empty if it is.
    """

    subject: str
    like: str
    word: str
    where: Origin | None
    unknown: str = ""


def holders(policy: LoadedPolicy, within: Glob, kind: str, permission: str, name: Glob) -> Iterator[Held]:
    """Yield who holds a permission: subjects that a policy names first, then one for each pattern of others.

    Where nothing is yielded nobody does: for every subject there is, and every name. A policy whose type does not tell
    how it is written is asked for the subjects that it names only.

    Args:
        policy: the policy.
        within: pattern of the subjects in question.
        kind: kind of the objects.
        permission: a permission of that kind.
        name: pattern of the objects in question; for kind ``topic`` with the partition.
    """
    exact = literal(within)
    named = (exact,) if exact is not None else matching(policy, within)
    for subject in named:
        found = held(rules_of(policy, subject), kind, permission, name)
        if found is not None:
            yield _said(subject, "", found, policy, kind, permission)
    written = structure(policy)
    if exact is None and written is not None:
        yield from _others(policy, written, within, kind, permission, name, set(named))


def held(rules: Sequence[Rule], kind: str, permission: str, name: Glob) -> Witness | Unknown | None:
    """Return the shortest of some names on which rules grant a permission, or None."""
    outcome = meet(kind, allowed(name), *conjunction(rules, kind, permission))
    return None if isinstance(outcome, Equal) else outcome


def granting(rules: Sequence[Rule], kind: str, permission: str, word: str) -> Rule | None:
    """Return the first rule that allows a name, itself or its first part."""
    part_kind, part, suffix = parts(kind, permission)[0]
    for rule in rules:
        if rule.effect is not Effect.ALLOW or (part_kind, part) not in keys(rule):
            continue
        for expression in rule.expressions:
            if any(matches(one, word + suffix) for one in patterns(rule, expression, (part_kind, part))):
                return rule
    return None


def _said(subject: str, like: str, found: Witness | Unknown, policy: LoadedPolicy, kind: str, permission: str) -> Held:
    if isinstance(found, Unknown):
        return Held(subject, like, "", None, found.reason)
    rule = granting(rules_of(policy, subject), kind, permission, found.word)
    return Held(subject, like, found.word, rule.origin if rule else None)


def _others(
    policy: LoadedPolicy,
    written: Structure,
    within: Glob,
    kind: str,
    permission: str,
    name: Glob,
    known: set[str],
) -> Iterator[Held]:
    """Yield those that a policy does not name."""
    try:
        classes = _possible(written, within, kind, permission, name)
    except TooComplexError:
        yield Held("", text(within), "", None, "the subjects cannot be told apart within bounds")
        return
    for subjects, word in classes.items():
        if literal(subjects) in known:
            continue
        for subject in _candidates(subjects, word, kind):
            if subject in known:
                continue
            found = held(rules_of(policy, subject), kind, permission, name)
            if isinstance(found, Witness):
                yield _said(subject, text(subjects), found, policy, kind, permission)
                break
        else:
            if can_be(subjects):
                yield Held("", text(subjects), "", None, "whether one of these does was not decided")


def _possible(written: Structure, within: Glob, kind: str, permission: str, name: Glob) -> dict[Glob, str]:
    """Return patterns of the subjects that can hold a permission at all, each with a name on which."""
    found: dict[Glob, str] = {}
    pieces = intersection(within, EVERY)
    for number, (part_kind, part, suffix) in enumerate(parts(kind, permission)):
        mine: dict[Glob, str] = {}
        for piece in pieces:
            for subjects, decided in at_most(written, piece, (part_kind, part)):
                outcome = meet(kind, allowed(name), without(decided, suffix))
                if not isinstance(outcome, Equal):
                    mine.setdefault(subjects, getattr(outcome, "word", ""))
        if not mine:
            return {}
        if number == 0:
            found = mine
    return found


def _candidates(subjects: Glob, word: str, kind: str) -> Iterator[str]:
    """Yield subjects that a pattern matches: one like any other, and some near the name that is asked for."""
    seen: set[str] = set()
    near = [subjects]
    if kind != "topic":
        segments = word.split("/")
        for at in range(len(segments) - 1, 0, -1):
            head = "/".join(segments[:at])
            for around in (surround(f"{head}/", (STAR,), ""), (head,) if head else None):
                if around is not None:
                    near += intersection(subjects, around)
        for segment in segments[:0:-1]:
            near += intersection(subjects, surround("", (STAR,), f"/{segment}"))
    for pattern in near:
        subject = example(pattern)
        if subject is not None and subject not in seen:
            seen.add(subject)
            yield subject
