# SPDX-License-Identifier: Apache-2.0
"""The index of rules decides as the reference evaluator, which tests every rule: effect, rules, reason and parts."""

from __future__ import annotations

import pytest
from hypothesis import example, given, strategies as st

from comarmor.errors import ComArmorError, Origin
from comarmor.language.policy import Policy
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from comarmor.rules import PARTS, PERMISSIONS, Effect, Rule
from tests.comarmor.language.reference_evaluator import decide

SUFFIXES = sorted({suffix for parts in PARTS.values() for _, _, suffix in parts})
NAMES = st.one_of(
    st.sampled_from(("", "/", "/a", "/a/b", "/ab", "/A", "a", "/a\n", "*", "/[a]", "/é")),
    st.builds(str.__add__, st.sampled_from(("", "/a", "/a/b", "/b")), st.sampled_from(SUFFIXES)),
    st.builds(lambda a, b, c: a + b + c, st.just("/a"), st.sampled_from(SUFFIXES), st.sampled_from(SUFFIXES)),
)
EXPRESSIONS = st.one_of(
    st.sampled_from(("/a", "/a/b", "/b", "*", "/*", "/a*", "*b", "/?", "/[ab]", "/[!a]*", r"/\*", r"\/a", "/a*b", "")),
    st.builds(str.__add__, st.sampled_from(("/a", "/*", "*")), st.sampled_from(SUFFIXES)),
)
PARTITIONS = st.lists(st.sampled_from(("", "p", "q", "pq")), max_size=3).map(tuple)


@st.composite
def rules(draw: st.DrawFn) -> Rule:
    kind = draw(st.sampled_from(sorted(PERMISSIONS)))
    permissions = draw(st.lists(st.sampled_from(PERMISSIONS[kind]), min_size=1, unique=True))
    partitions = (
        draw(st.lists(st.sampled_from(("", "p", "q*", "*")), max_size=2, unique=True)) if kind == "topic" else ()
    )
    return Rule(
        draw(st.sampled_from(Effect)),
        kind,
        tuple(permissions),
        tuple(draw(st.lists(EXPRESSIONS, min_size=1, max_size=3, unique=True))),
        tuple(partitions),
        draw(st.booleans()),
        Origin("policy.xml", draw(st.integers(1, 9))),
    )


def policy_of(drawn: list[Rule]) -> Policy:
    """Return the policy that has these rules for /s."""
    place = Origin("policy.xml")
    written = tuple(
        ProfileRule(
            rule.effect,
            rule.kind,
            rule.permissions,
            tuple(Attachment(expression, rule.origin) for expression in rule.expressions),
            rule.partitions,
            rule.audit,
            rule.origin,
        )
        for rule in drawn
    )
    return Policy((Profile("", False, (Attachment("/s", place),), (), written, place),))


REQUESTS = st.sampled_from(
    [(kind, permission) for kind, permissions in PERMISSIONS.items() for permission in permissions]
)
TWICE = Rule(Effect.ALLOW, "ros_action", ("ros_request",), ("/a",), (), False, Origin("policy.xml", 1))


@given(st.lists(rules(), max_size=6), st.lists(st.tuples(REQUESTS, NAMES, PARTITIONS), min_size=1, max_size=8))
@example([TWICE, TWICE], [(("ros_topic", "ros_subscribe"), "/a/_action/status", ())])
def test_the_index_decides_as_the_reference(
    drawn: list[Rule], requests: list[tuple[tuple[str, str], str, tuple[str, ...]]]
) -> None:
    policy = policy_of(drawn)
    for (kind, permission), name, partitions in requests:
        expected = decide(drawn, kind, permission, name, partitions)
        decided = policy.decide("/s", kind, permission, name, partitions)
        assert decided == expected
        assert decided.audit == expected.audit


@given(st.lists(rules(), max_size=6), REQUESTS, st.lists(NAMES, max_size=8))
def test_many_names_are_decided_as_one_by_one(drawn: list[Rule], request: tuple[str, str], names: list[str]) -> None:
    expected = bytes(decide(drawn, *request, name).allowed for name in names)
    assert policy_of(drawn).row("/s", *request).allowed(names) == expected


def test_an_unknown_kind_or_permission_is_refused() -> None:
    with pytest.raises(ComArmorError, match=r"unknown kind 'ros_topics'.*ros_topic"):
        policy_of([]).row("/s", "ros_topics", "ros_publish")
    with pytest.raises(ComArmorError, match=r"unknown permission 'ros_call' of ros_topic"):
        policy_of([]).row("/s", "ros_topic", "ros_call")
