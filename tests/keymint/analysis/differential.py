# SPDX-License-Identifier: Apache-2.0
"""``diff`` against brute force, on policies that are one edit apart."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import keymint_ros2_comarmor

import comarmor
from comarmor.errors import Origin
from comarmor.patterns.expression import matches
from comarmor.patterns.glob import parse
from keymint.analysis.policy_diff import SubjectChanges, diff_policies, has_gains
from keymint.analysis.query import PermissionHolder, who_can
from keymint.api import PolicySource
from tests.comarmor.language.reference_evaluator import decide
from tests.keymint.analysis.edits import OBJECTS, SEGMENTS, edited, random_policy

DEEPEST = 3
_PARTITIONS = ("", "p", "q", "pp", "x")
_TOPICS = ("a", "b", "c", "ab", "rt/a", "rt/a/a", "rt/b/a", "xa", "xb", "xab", "x", "d")
Request = tuple[str, str, str, str, str]
"""Subject, kind, permission, object, partition."""


@dataclass(frozen=True)
class Verdict:
    """What was found out about a pair.

    Attributes:
        differs: brute force found a difference.
        undecided: ``diff`` says that it does not know something.
        wrong: what ``diff`` missed, or said wrongly; empty if nothing.
    """

    differs: bool
    undecided: bool
    wrong: str


def compared(old: str, new: str) -> Verdict:
    """Compare what ``diff`` says of two policies with what the reference evaluator says of each request there is."""
    one, other = _loaded(old), _loaded(new)
    found = diff_policies(one, other)
    undecided = any(change.unknown for each in found for change in each.changes)
    requests = list(_differing(one.policy, other.policy))
    wrong = [*_missed(requests, found), *_false(one.policy, other.policy, found)]
    if any(allowed for _, allowed in requests) and not has_gains(found):
        wrong.append("no gain is reported")
    return Verdict(bool(requests), undecided, "; ".join(wrong[:3]))


def _loaded(text: str) -> keymint_ros2_comarmor.ComArmorPolicy:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "policy.xml")
        path.write_text(text)
        return keymint_ros2_comarmor.policy_type.load([PolicySource("policy.xml", path, Origin("policy.xml"))], None)


def _differing(old: comarmor.Policy, new: comarmor.Policy) -> Iterator[tuple[Request, bool]]:
    """Yield the requests that the policies decide otherwise, and whether the newer one allows it."""
    for subject in _subjects():
        before, after = old.rules(subject), new.rules(subject)
        if set(map(_said, before)) != set(map(_said, after)):
            yield from _of_rules(subject, before, after)


def _said(rule: comarmor.Rule) -> tuple[object, ...]:
    return rule.effect, rule.kind, rule.permissions, rule.expressions, rule.partitions


def _of_rules(
    subject: str, before: Sequence[comarmor.Rule], after: Sequence[comarmor.Rule]
) -> Iterator[tuple[Request, bool]]:
    used = {(rule.kind, held) for rule in (*before, *after) for held in rule.permissions}
    parts = {part[:2] for key in used for part in comarmor.PARTS.get(key, ())}
    suffixes = sorted({suffix for key in used for _, _, suffix in comarmor.PARTS.get(key, ())})
    texts = sorted({each for rule in (*before, *after) for each in rule.expressions})
    names = _classes(_objects(subject), texts, suffixes)
    for kind, permission in sorted(used | parts):
        for name in _TOPICS if kind == "topic" else names:
            for partition in _PARTITIONS if kind == "topic" else ("",):
                asked = (partition,) if partition else ()
                was, now = (decide(rules, kind, permission, name, asked).allowed for rules in (before, after))
                if was is not now:
                    yield (subject, kind, permission, name, partition), now


def _classes(names: Sequence[str], texts: Sequence[str], suffixes: Sequence[str]) -> list[str]:
    """Return a name of each class that the expressions tell apart, with and without suffixes of composite kinds."""
    found: dict[tuple[str, tuple[bool, ...]], str] = {}
    for name in names:
        group = tuple(matches(text, name) for text in texts)
        for suffix in ("", *suffixes):
            if ("", group) not in found or suffix:
                whole = tuple(matches(text, name + suffix) for text in texts) if suffix else ()
                found.setdefault((suffix, (*group, *whole)), name + suffix)
    return list(found.values())


def _subjects() -> list[str]:
    return ["/" + "/".join(segments) for depth in range(1, DEEPEST) for segments in product(SEGMENTS, repeat=depth)] + [
        "/" + "/".join(segments) for segments in product("abd", repeat=DEEPEST)
    ]


def _objects(subject: str) -> list[str]:
    head, _, name = subject.rpartition("/")
    near = [f"{head}/{each}" for each in ("a", "b", "c", name, f"{name}/a", f"{name}/b", f"{name}/d")]
    near += [f"/{each}/{name}" for each in ("a", "c", "d", f"a/{name}", name)] + [
        f"/a/{name}/b",
        f"/{name}",
        f"/c{head}/a",
    ]
    return list(dict.fromkeys((*near, *_subjects())))


def _missed(requests: Sequence[tuple[Request, bool]], found: Sequence[SubjectChanges]) -> Iterator[str]:
    """Yield what brute force found and ``diff`` does not say, of the subject or of a pattern that matches it."""
    for (subject, kind, permission, name, partition), allowed in requests:
        parts = {part[:2] for part in comarmor.PARTS.get((kind, permission), ())}
        said = any(
            _about(each, subject)
            and any(
                change.unknown
                or (
                    change.gains is allowed
                    and (
                        (change.kind, change.permission) in {(kind, permission), *parts}
                        or (kind, permission)
                        in {part[:2] for part in comarmor.PARTS.get((change.kind, change.permission), ())}
                    )
                )
                for change in each.changes
            )
            for each in found
        )
        if not said:
            what = "gains" if allowed else "loses"
            yield f"missed: {subject} {what} {permission} {name}" + (f" in {partition}" if partition else "")


def _about(each: SubjectChanges, subject: str) -> bool:
    return matches(each.like, subject) if each.like else each.subject == subject


def _false(old: comarmor.Policy, new: comarmor.Policy, found: Sequence[SubjectChanges]) -> Iterator[str]:
    for each in found:
        for change in each.changes:
            if change.unknown:
                continue
            partition, _, name = change.word.rpartition("\0")
            asked = (each.subject, change.kind, change.permission, name, (partition,) if partition else ())
            if (old.decide(*asked).allowed, new.decide(*asked).allowed) != (not change.gains, change.gains):
                yield f"false: {asked}"


def pair(seed: int) -> tuple[str, str, str]:
    """Return the name of an edit, and the policy before and after it."""
    rng = random.Random(seed)
    policy = random_policy(rng)
    name, changed = edited(rng, policy)
    return name, policy.xml(), changed.xml()


@dataclass(frozen=True)
class Answer:
    """What ``query who`` says.

    Attributes:
        held: somebody holds the permission, by brute force.
        perhaps: ``who`` is not certain about some subjects.
        wrong: whom ``who`` missed, or named wrongly; empty if nobody.
    """

    held: bool
    perhaps: bool
    wrong: str


def asked(seed: int) -> Answer:
    """Ask a random policy who can do something, and hold the answer against what the reference evaluator decides."""
    rng = random.Random(seed)
    loaded = _loaded(random_policy(rng).xml())
    kind = rng.choice([kind for kind in comarmor.PERMISSIONS if kind != "topic"])
    permission = rng.choice(comarmor.PERMISSIONS[kind][:2])
    name = rng.choice([each for each in OBJECTS if "{" not in each])
    found = list(who_can(loaded, parse("*"), kind, permission, parse(name)))
    holding = [
        subject
        for subject in _subjects()
        if (rules := loaded.policy.rules(subject))
        and any(matches(name, each) and decide(rules, kind, permission, each).allowed for each in _objects(subject))
    ]
    certain = [each for each in found if not each.unknown]
    wrong = [f"{each.subject} cannot" for each in certain if not _holds(loaded, each, permission, kind)]
    wrong += [
        f"{subject} can {permission} {name}"
        for subject in holding
        if not any(each.subject == subject or (each.like and matches(each.like, subject)) for each in found)
    ]
    return Answer(bool(holding), any(each.unknown for each in found), "; ".join(wrong[:3]))


def _holds(loaded: keymint_ros2_comarmor.ComArmorPolicy, each: PermissionHolder, permission: str, kind: str) -> bool:
    return loaded.policy.decide(each.subject, kind, permission, each.word).allowed
