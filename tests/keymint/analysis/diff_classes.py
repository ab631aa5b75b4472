# SPDX-License-Identifier: Apache-2.0
"""What ``diff`` prints, read as a reader takes it, against brute force over small names."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from pathlib import Path
from typing import Any

from comarmor.patterns.expression import matches as expression_matches
from comarmor.rules import PARTS, Rule, parts
from keymint.analysis.policy_diff import diff_policies
from keymint.analysis.symbolic_search import QueryBudget
from keymint.api import LoadedPolicy
from keymint.output.differences import as_text, differences_json
from tests.keymint.analysis.policies import deny, loaded_text, rule

LETTERS = "abst"
SUBJECTS = ["/", *("/" + "/".join(each) for depth in (1, 2) for each in product(LETTERS, repeat=depth))]
SUBJECTS += ["/a/b/s", "/b/a/b", "/s/s/s", "/a/a/a", "/ab", "/z", "/z/z", "/z/a", "/a/z", "/z/z/z"]
OBJECTS = ["/" + "/".join(each) for depth in (1, 2) for each in product("abstz", repeat=depth)]
OBJECTS += ["/" + "/".join(each) for each in product("abt", repeat=3)]
ATTACHMENTS = (
    "/*",
    "/[ab]",
    "/[ab]*",
    "/a*",
    "/*/*",
    "/*/b",
    "/a/*",
    "/[!a]",
    "/?",
    "*b",
    "/[st]/*",
    "/a",
    "/a/b",
    "/*a*",
)
FIXED = ("/a", "/b", "/s", "/t", "/[ab]", "/a/[st]", "/b/t", "/*", "/a/*", "*b", "/?", "/a*", "/[!t]")
TEMPLATES = (
    *("{namespace}t", "{namespace}{name}", "{namespace}{name}/t", "/a/{name}", "/{name}", "{namespace}*", "/{name}/t"),
    *("{namespace}[ab]", "{namespace}{name}/*", "/{name}/{name}"),
)
KINDS = (("ros_topic", "ros_publish"),) * 5 + (("ros_topic", "ros_subscribe"), ("ros_action", "ros_request"))
Change = tuple[str, str, str, bool]
"""Kind, permission and object of what changes, and whether it is gained."""


@dataclass(frozen=True)
class Pair:
    """Two policies.

    Attributes:
        old: text of the older one.
        new: text of the newer one.
        templates: some rules have placeholders.
    """

    old: str
    new: str
    templates: bool


def pair(seed: int) -> Pair:
    """Return two policies of nested profiles; the newer one has other rules, denials or attachments in places."""
    rng = random.Random(seed)
    templates = seed % 2 == 1
    old, new = zip(*(_profile(rng, templates, 0) for _ in range(rng.choice((1, 2, 2, 3)))), strict=True)
    return Pair(*(f"<profiles>\n{''.join(each)}</profiles>" for each in (old, new)), templates)


def _profile(rng: random.Random, templates: bool, depth: int) -> tuple[str, str]:
    """Return a profile of the older and of the newer policy."""
    inner = [_profile(rng, templates, depth + 1) for _ in range(rng.choice((0, 0, 1)) if depth < 2 else 0)]
    inside = [_rules(rng, templates) for _ in range(rng.choice((1, 1, 2)))] + inner
    names = rng.sample(ATTACHMENTS, rng.choice((1, 1, 1, 2)))
    others = rng.sample(ATTACHMENTS, 1) if rng.random() < 0.1 else names
    written = [_written(names, [one for one, _ in inside]), _written(others, [other for _, other in inside])]
    if rng.random() < 0.1:
        written[rng.randrange(2)] = ""
    return written[0], written[1]


def _written(names: Sequence[str], inside: Sequence[str]) -> str:
    attached = "".join(f"<attachment>{name}</attachment>" for name in names)
    return f'<profile name="p">{attached}\n{"".join(inside)}</profile>\n'


def _rules(rng: random.Random, templates: bool) -> tuple[str, str]:
    kind, permission = rng.choice(KINDS)
    names = rng.sample((*FIXED, *TEMPLATES) if templates else FIXED, rng.choice((1, 1, 2)))
    written = (deny if rng.random() < 0.3 else rule)(kind, permission, *names)
    return rng.choice(((written, written), (written, written), (written, ""), ("", written)))


@dataclass(frozen=True)
class Verdict:
    """What is wrong with what ``diff`` prints.

    Attributes:
        wrong: a text for each changed request that no line covers, and for each line that is false for a subject.
        differs: brute force found a difference.
        unknown: lines that say that something is not known.
        lines: all lines.
    """

    wrong: list[str]
    differs: bool
    unknown: int
    lines: int


def judged(folder: Path, written: Pair, budget: QueryBudget | None = None) -> Verdict:
    """Return the verdict on the comparison of two policies."""
    old, new = (loaded_text(folder, text, name=f"{n}.xml") for n, text in enumerate((written.old, written.new)))
    differences = diff_policies(old, new, budget)
    entries = differences_json(differences, str)  # type: ignore[arg-type]
    text = [line for line in as_text(differences, lambda _: "") if not line.startswith("  ")]
    wrong = [
        f"unlike the text: {each}" for each, line in zip(entries, text, strict=True) if not _same_class(each, line)
    ]
    changes = {subject: frozenset(_changes(old, new, subject)) for subject in SUBJECTS}
    for subject, real in changes.items():
        about = [each for each in entries if _is_about(each, subject)]
        wrong += _uncovered(subject, real, about)
        wrong += (text for each in about for text in _false(subject, real, each, old, new))
    if not written.templates:
        for each in entries:
            members = {
                _common(real) for subject, real in changes.items() if each["stands_for"] and _is_about(each, subject)
            }
            if len(members) > 1 and not any(change["unknown"] for change in each["changes"]):
                wrong.append(f"members of {each['stands_for']} except {each.get('except')} differ")
    lines = [change for each in entries for change in each["changes"]]
    unknown = sum(change["unknown"] is not None for change in lines)
    return Verdict(wrong, any(changes.values()), unknown, len(lines))


def _same_class(entry: Mapping[str, Any], line: str) -> bool:
    return all(text in line for text in (entry["subject"], entry["stands_for"], *entry.get("except", ())) if text)


def _is_about(entry: Mapping[str, Any], subject: str) -> bool:
    """Return whether a subject is a member of the class that an entry names."""
    if not entry["stands_for"]:
        return bool(entry["subject"] == subject)
    return _matches(entry["stands_for"], subject) and not any(
        _matches(each, subject) for each in entry.get("except", ())
    )


def _filled(pattern: str, subject: str) -> str:
    head, _, last = subject.rpartition("/")
    return pattern.replace("{namespace}", f"{head}/").replace("{name}", last)


def _uncovered(subject: str, real: frozenset[Change], about: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    said: set[tuple[str, str, str, bool]] = set()
    for line in (line for each in about for line in each["changes"]):
        if line["unknown"]:
            return
        for kind, part, suffix in parts(line["kind"], line["permission"]):
            said.add((kind, part, _filled(line["pattern"], subject) + suffix, line["change"] == "gains"))
    for kind, permission, name, gained in sorted(real):
        if (kind, permission) in PARTS:
            continue
        if not any(each[:2] == (kind, permission) and each[3] is gained and _matches(each[2], name) for each in said):
            yield f"uncovered: {subject} {'gains' if gained else 'loses'} {permission} {name}"


def _false(
    subject: str, real: frozenset[Change], entry: Mapping[str, Any], old: LoadedPolicy, new: LoadedPolicy
) -> Iterator[str]:
    if not any(line["unknown"] for line in entry["changes"]):
        applies = {"before": old.rules(subject) is not None, "after": new.rules(subject) is not None}
        if entry["applies"] != applies:
            yield f"false: {subject} {entry['applies']}, but {applies}"
    for line in entry["changes"]:
        if line["unknown"]:
            continue
        gained = line["change"] == "gains"
        key = (line["kind"], line["permission"])
        pattern = _filled(line["pattern"], subject)
        found = {name for *held, name, gains in real if (*held,) == key and gains is gained}
        where = (
            f"{subject} as of {entry['stands_for'] or entry['subject']} except {entry.get('except')}: {line['change']}"
        )
        if line["whole"] and any(_matches(pattern, name) and name not in found for name in _objects(subject)):
            yield f"false: {where} all of {key[1]} {pattern}"
        fixed = "{" not in line["pattern"] or subject == entry["subject"]
        if not (line["whole"] or fixed or any(_matches(pattern, name) for name in found)):
            yield f"false: {where} part of {key[1]} {pattern}"
        if fixed and _decided(old, new, subject, *key, line["example"]) != (not gained, gained):
            yield f"false: {where} {key[1]} {line['example']}"


def _changes(old: LoadedPolicy, new: LoadedPolicy, subject: str) -> Iterator[Change]:
    for kind, permission in dict.fromkeys((*KINDS, *(part[:2] for key in KINDS for part in PARTS.get(key, ())))):
        suffixes = {
            suffix for key in KINDS for of, part, suffix in PARTS.get(key, ()) if (of, part) == (kind, permission)
        }
        for name, suffix in product(_objects(subject), ("", *suffixes)):
            before, after = _decided(old, new, subject, kind, permission, name + suffix)
            if before is not after:
                yield kind, permission, name + suffix, after


def _decided(
    old: LoadedPolicy, new: LoadedPolicy, subject: str, kind: str, permission: str, name: str
) -> tuple[bool, bool]:
    before, after = (_allowed(_rules_of(policy, subject), kind, permission, name) for policy in (old, new))
    return before, after


@lru_cache(maxsize=1 << 8)
def _rules_of(policy: LoadedPolicy, subject: str) -> tuple[Rule, ...]:
    found = policy.rules(subject)
    return found.rules if found else ()


def _allowed(rules: Sequence[Rule], kind: str, permission: str, name: str) -> bool:
    for part_kind, part, suffix in parts(kind, permission):
        effects = {
            each.effect.value
            for each in rules
            for end in _ends(each.kind, each.permissions, part_kind, part)
            if any(_matches(expression + end, name + suffix) for expression in each.expressions)
        }
        if effects != {"ALLOW"}:
            return False
    return True


def _common(real: frozenset[Change]) -> frozenset[Change]:
    """Return the changes on objects that are tried for each subject."""
    return frozenset(each for each in real if each[2].split("/_action/")[0] in OBJECTS)


@cache
def _objects(subject: str) -> list[str]:
    near = [f"{subject}/{name}" for name in LETTERS if subject != "/"]
    return list(dict.fromkeys((*OBJECTS, *near)))


@cache
def _ends(kind: str, permissions: tuple[str, ...], part_kind: str, part: str) -> tuple[str, ...]:
    """Return the suffixes with which a rule is about a permission without parts."""
    return tuple(
        suffix
        for permission in permissions
        for of, held, suffix in parts(kind, permission)
        if (of, held) == (part_kind, part)
    )


@cache
def _matches(expression: str, name: str) -> bool:
    return expression_matches(expression, name)
