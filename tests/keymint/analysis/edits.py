# SPDX-License-Identifier: Apache-2.0
"""Random policies that are one edit apart: for tests that compare the reported differences with what both decide."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from comarmor import PARTS, PERMISSIONS

SEGMENTS = ("a", "b", "c", "ab", "ba", "d")
SUBJECTS = (
    "/a", "/b", "/a/b", "/a/a", "/a*", "/[ab]*", "/*", "*", "/?", "/a/*", "/*/b", "/[ab]/b", "/[a-c]", "/[!a]/b",
    "/?/b", "/a/[ab]", "/*b", "*b", "*/a", "/a?", "/[ab]?", "/?b", "/b/*", "/*/*", "/[b-d]/*", "/a[!b]*", "/@{T}",
    "/@{T}/*", "/c/@{T}", "/[a-b]/*/b", "/*a*", "/a*b",
    "/a[/b]*", "/[!b]*", "/*[ab]", "/?[/]b", "/a[!/]b", "/\\a", "/[[:alpha:]]", "/*/*/b", "/a*/*b", "*[ab]/[ab]*",
    "/d*[!b]",
)  # fmt: skip
"""Attachments of profiles."""
OBJECTS = (
    "/a", "/b", "/c/a", "/a/b", "/a/*", "/*", "*", "/[ab]", "/?", "/[!a]", "/*b", "*/b", "/a*", "/b/*", "/a/[ab]",
    "/@{T}", "/c/@{T}", "{namespace}a", "{namespace}*", "{namespace}/b", "{namespace}{name}", "{namespace}{name}/a",
    "/c/{name}", "/{name}", "{namespace}{name}/*", "*/{name}", "/c{namespace}a", "/*/{name}/*", "{namespace}[ab]",
    "/{name}/{name}", "/?/{name}", "{namespace}@{T}",
    "[/]{namespace}a", "{namespace}{namespace}a", "/{name}{namespace}a", "/?{name}", "*{namespace}*", "{namespace}?",
    "{namespace}*{name}", "*{name}*", "/a{name}", "/{name}b", "{namespace}{name}{name}", "/a/{name}/{name}",
    "*/a{namespace}b", "{namespace}[!a]", "/[ab]{namespace}a", "/*{name}", "{namespace}a*", "{namespace}*a",
)  # fmt: skip
"""Attachments of rules."""
RAW = ("a", "b", "?", "[ab]", "*", "a*", "rt/a", "{name}", "rt{namespace}a", "x@{T}")
PARTITIONS = ("p", "q", "p*", "?", "*", "[pq]")
VALUES = ("a", "b", "[ab]", "*", "ab")


@dataclass
class Rule:
    """A rule, to be edited."""

    effect: str
    kind: str
    permissions: list[str]
    attachments: list[str]
    partitions: list[str] = field(default_factory=list)

    def xml(self) -> str:
        """Return it as it is written in a policy."""
        attached = "".join(f"<attachment>{each}</attachment>" for each in self.attachments)
        held = "".join(f"<{each}/>" for each in self.permissions)
        parted = "".join(f"<partition>{each}</partition>" for each in self.partitions)
        more = f"<partitions>{parted}</partitions>" if parted else ""
        return (
            f'<{self.kind} qualifier="{self.effect}">{attached}<permissions>{held}</permissions>{more}</{self.kind}>\n'
        )


@dataclass
class Profile:
    """A profile, to be edited."""

    attachments: list[str]
    rules: list[Rule]
    inner: list[Profile] = field(default_factory=list)

    def xml(self) -> str:
        """Return it as it is written in a policy."""
        attached = "".join(f"<attachment>{each}</attachment>" for each in self.attachments)
        inside = "".join(each.xml() for each in (*self.rules, *self.inner))
        return f'<profile name="p">{attached}\n{inside}</profile>\n'


@dataclass
class Policy:
    """A policy, to be edited."""

    profiles: list[Profile]
    values: list[str]

    def xml(self) -> str:
        """Return it as it is written."""
        values = "".join(f"<value>{each}</value>" for each in self.values)
        tunable = f'<tunable name="T">{values}</tunable>\n'
        return f"<profiles>{tunable}{''.join(each.xml() for each in self.profiles)}</profiles>"

    def all(self) -> list[Profile]:
        """Return all profiles, nested ones too."""
        found, todo = [], [*self.profiles]
        while todo:
            found.append(todo.pop())
            todo += found[-1].inner
        return found

    def rules(self) -> list[tuple[Profile, Rule]]:
        """Return all rules, each with its profile."""
        return [(profile, rule) for profile in self.all() for rule in profile.rules]


def random_policy(rng: random.Random) -> Policy:
    """Return a policy of one to three profiles, nested or not."""
    return Policy([_profile(rng, 0) for _ in range(rng.choice((1, 1, 2, 3)))], rng.sample(VALUES, rng.choice((1, 2))))


def edited(rng: random.Random, policy: Policy) -> tuple[str, Policy]:
    """Return a policy that is one edit apart, and the name of the edit; some edits change no meaning."""
    found = copy.deepcopy(policy)
    edit = rng.choice(EDITS)
    edit(rng, found)
    return edit.__name__.strip("_"), found


def _profile(rng: random.Random, depth: int) -> Profile:
    inner = [_profile(rng, depth + 1)] if depth < 2 and rng.random() < 0.35 else []
    rules = [_rule(rng) for _ in range(rng.choice((1, 1, 2, 3)))]
    return Profile(rng.sample(SUBJECTS, rng.choice((1, 1, 2))), rules, inner)


def _rule(rng: random.Random) -> Rule:
    kind = rng.choice(("ros_topic", "ros_topic", "ros_topic", "ros_service", "ros_action", "ros_parameter", "topic"))
    permissions = rng.sample(PERMISSIONS[kind][:2], rng.choice((1, 1, 2)))
    effect = rng.choice(("ALLOW", "ALLOW", "DENY"))
    attachments = rng.sample(RAW if kind == "topic" else OBJECTS, rng.choice((1, 1, 2)))
    partitions = rng.sample(PARTITIONS, rng.choice((0, 1, 2))) if kind == "topic" else []
    return Rule(effect, kind, permissions, attachments, partitions)


def _attach(rng: random.Random, policy: Policy) -> None:
    profile = rng.choice(policy.all())
    profile.attachments[rng.randrange(len(profile.attachments))] = rng.choice(SUBJECTS)


def _attach_more(rng: random.Random, policy: Policy) -> None:
    rng.choice(policy.all()).attachments.append(rng.choice(SUBJECTS))


def _attach_less(rng: random.Random, policy: Policy) -> None:
    profile = rng.choice(policy.all())
    if len(profile.attachments) > 1:
        profile.attachments.pop()


def _object(rng: random.Random, policy: Policy) -> None:
    _, rule = rng.choice(policy.rules())
    rule.attachments[rng.randrange(len(rule.attachments))] = rng.choice(RAW if rule.kind == "topic" else OBJECTS)


def _rule_more(rng: random.Random, policy: Policy) -> None:
    rng.choice(policy.all()).rules.append(_rule(rng))


def _rule_less(rng: random.Random, policy: Policy) -> None:
    profile, rule = rng.choice(policy.rules())
    profile.rules.remove(rule)


def _flip(rng: random.Random, policy: Policy) -> None:
    _, rule = rng.choice(policy.rules())
    rule.effect = "DENY" if rule.effect == "ALLOW" else "ALLOW"


def _permission(rng: random.Random, policy: Policy) -> None:
    _, rule = rng.choice(policy.rules())
    rule.permissions = rng.sample(PERMISSIONS[rule.kind], rng.choice((1, 2)))


def _partition(rng: random.Random, policy: Policy) -> None:
    raw = [rule for _, rule in policy.rules() if rule.kind == "topic"]
    if raw:
        rng.choice(raw).partitions = rng.sample(PARTITIONS, rng.choice((0, 1, 2)))
    else:
        _rule_more(rng, policy)


def _nest(rng: random.Random, policy: Policy) -> None:
    profile, rule = rng.choice(policy.rules())
    profile.rules.remove(rule)
    profile.inner.append(Profile([rng.choice(SUBJECTS)], [rule]))


def _value(rng: random.Random, policy: Policy) -> None:
    policy.values = rng.sample(VALUES, rng.choice((1, 2, 3)))


def _copy(rng: random.Random, policy: Policy) -> None:
    profile, rule = rng.choice(policy.rules())
    profile.rules.append(copy.deepcopy(rule))


def _inner_copy(rng: random.Random, policy: Policy) -> None:
    """Say a rule again in a profile inside: changes nothing."""
    profile, rule = rng.choice(policy.rules())
    profile.inner.append(Profile([rng.choice(SUBJECTS)], [copy.deepcopy(rule)]))


def _moved(rng: random.Random, policy: Policy) -> None:
    """Put each rule of a profile into a profile inside that applies to all: changes nothing."""
    profile = rng.choice(policy.all())
    profile.inner.append(Profile(["*"], profile.rules))
    profile.rules = []


def _split(rng: random.Random, policy: Policy) -> None:
    """Write ``[ab]`` as two expressions: changes nothing."""
    lists = [*(each.attachments for each in policy.all()), *(rule.attachments for _, rule in policy.rules())]
    for found in lists:
        for each in [one for one in found if "[ab]" in one]:
            found.remove(each)
            found += [each.replace("[ab]", "a"), each.replace("[ab]", "b")]
    rng.shuffle(policy.profiles)


def _parts(rng: random.Random, policy: Policy) -> None:
    """Write a rule of a composite kind as what it stands for: changes nothing."""
    for profile, rule in policy.rules():
        if (rule.kind, rule.permissions[0]) in PARTS:
            profile.rules.remove(rule)
            for held in rule.permissions:
                for kind, part, suffix in PARTS[rule.kind, held]:
                    named = [each + suffix for each in rule.attachments if not each.endswith("{namespace}")]
                    profile.rules.append(Rule(rule.effect, kind, [part], named))
            return
    _split(rng, policy)


def _spelled(rng: random.Random, policy: Policy) -> None:
    """Write the values of the tunable where it is used: changes nothing."""
    lists = [*(each.attachments for each in policy.all()), *(rule.attachments for _, rule in policy.rules())]
    for found in lists:
        found[:] = [one for each in found for one in dict.fromkeys(each.replace("@{T}", v) for v in policy.values)]
    rng.shuffle(policy.profiles)


Edit = Callable[[random.Random, Policy], None]
EDITS: tuple[Edit, ...] = (
    _attach, _attach, _attach, _attach_more, _attach_less, _object, _object, _rule_more, _rule_less, _flip, _permission,
    _partition, _nest, _value, _copy, _inner_copy, _moved, _split, _parts, _spelled,
)  # fmt: skip
