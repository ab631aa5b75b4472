# SPDX-License-Identifier: Apache-2.0
"""Names that probe patterns: inside, just outside, and never too many."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import example, given, settings, strategies as st

from comarmor.errors import Origin
from comarmor.patterns import glob
from comarmor.patterns.glob import matcher
from comarmor.rules import Effect
from keymint.api.graph import Edge, Object
from keymint.ir import Rule, SubjectRules
from keymint.verify import probes

HERE = Origin("policy.xml", 1)
PIECES = st.sampled_from(["*", "?", "[abc]", "[a-d]", "[!x]", "/a", "/b1", "c", "_"])
PATTERNS = st.lists(PIECES, min_size=1, max_size=5).map("".join)


def edges_of(rules: list[SubjectRules], domains: dict[str, int], *others: Any, **named: Any) -> Iterator[Edge]:
    return probes.edges(rules, probes.common_objects(rules), domains, *others, **named)


def rule(kind: str, permissions: list[str], expressions: list[str], partitions: tuple[str, ...] = ()) -> Rule:
    return Rule(Effect.ALLOW, kind, tuple(permissions), tuple(expressions), partitions, False, HERE)


def matching(expression: str) -> tuple[set[str], set[str]]:
    matches = matcher(glob.parse(expression))
    names = probes.names(expression)
    return {name for name in names if matches(name)}, {name for name in names if not matches(name)}


@pytest.mark.parametrize(
    ("expression", "inside", "outside"),
    [
        ("/chatter", {"/chatter"}, {"/chatterx", "/chatte", "/CHATTER", "/chatter/x"}),
        ("/a/*", {"/a/", "/a/x", "/a/y/z"}, {"/a", "/ax", "/x/a/x", "/A/x"}),
        ("*/scan", {"/scan", "/n/scan", "y/z/scan"}, {"x/scanx", "x/sca", "x/SCAN"}),
        ("/a?", {"/ab", "/a/"}, {"/a", "/aax"}),
        ("/a[bc]", {"/ab", "/ac"}, {"/aa", "/ad", "/a"}),
        ("/a[!0-9]", {"/aa", "/a/"}, {"/a0", "/a9", "/a"}),
    ],
)
def test_inside_and_just_outside(expression: str, inside: set[str], outside: set[str]) -> None:
    found_inside, found_outside = matching(expression)
    assert inside <= found_inside
    assert outside <= found_outside


@given(PATTERNS)
def test_both_sides_of_any_pattern_are_probed(expression: str) -> None:
    inside, outside = matching(expression)
    assert inside
    assert outside or set(expression) <= {"*", "?"}


@given(PATTERNS)
def test_names_are_bounded_and_plain(expression: str) -> None:
    names = probes.names(expression)
    assert len(names) <= probes.MOST_OF_A_PATTERN
    assert len(set(names)) == len(names)
    assert all(name.replace("/", "").replace("_", "").isalnum() or set(name) <= set("/_") for name in names)


MUTATIONS = [
    ("*", ""),
    ("?", "*"),
    ("[abc]", "[ab]"),
    ("[abc]", "[abcd]"),
    ("[!x]", "?"),
    ("/a", "/A"),
    ("/b1", "/b"),
    ("c", "?"),
]


@settings(deadline=None)
@example(["*"], ("[abc]", "[ab]"), ["*", "?"])
@given(st.lists(PIECES, max_size=2), st.sampled_from(MUTATIONS), st.lists(PIECES, max_size=2))
def test_a_pattern_that_one_edit_changes_differs_on_a_probe(
    before: list[str], change: tuple[str, str], after: list[str]
) -> None:
    """What a document says instead is found on the names of the pattern that the policy says, or of its own."""
    expression, edited = ("".join([*before, piece, *after]) for piece in change)
    one, other = matcher(glob.parse(expression)), matcher(glob.parse(edited))
    words = ("".join(word) for size in range(6) for word in itertools.product("/abcd1_A", repeat=size))
    if any(one(word) != other(word) for word in words):
        assert any(one(name) != other(name) for name in (*probes.names(expression), *probes.names(edited)))


def test_edges_are_grouped_by_subject_and_bounded() -> None:
    rules = [
        SubjectRules(f"/s{n}", (rule("ros_topic", ["ros_publish"], [f"/t{n}_{m}" for m in range(100)]),))
        for n in range(30)
    ]
    edges = list(edges_of(rules, {}))
    groups = [(key, list(group)) for key, group in itertools.groupby(edges, key=lambda edge: edge.subject)]
    assert [key for key, _ in groups] == [each.subject for each in rules]
    assert len(edges) == len(set(edges))
    for each, (_, group) in zip(rules, groups, strict=True):
        own = {edge.object.name for edge in group}
        assert set(each.rules[0].expressions) <= own
        assert len(own) < probes.MOST_OF_OTHERS + 100 * 8


def test_composites_are_asked_for_with_their_parts() -> None:
    rules = [SubjectRules("/s", (rule("ros_action", ["ros_request"], ["/move"]),))]
    objects = {edge.object for edge in edges_of(rules, {"/s": 7})}
    assert Object("ros_action", "/move") in objects
    assert Object("ros_service", "/move/_action/send_goal") in objects
    assert Object("ros_topic", "/move/_action/status") in objects
    assert {edge.domain for edge in edges_of(rules, {"/s": 7})} == {7}


def test_partitions_are_probed() -> None:
    rules = [SubjectRules("/s", (rule("topic", ["publish"], ["t"], ("ops", "r*")),))]
    asked = {edge.object.partitions for edge in edges_of(rules, {}) if edge.object.name == "t"}
    assert {(), ("ops",), ("opsx",), ("r",), ("", "ops"), ("ops", "r")} <= asked


def test_a_ros_name_begins_with_a_slash() -> None:
    rules = [SubjectRules("/s", (rule("ros_topic", ["ros_publish"], ["*"]),))]
    assert {edge.object.name[0] for edge in edges_of(rules, {})} == {"/"}


def test_what_the_documents_mention_is_asked_for_once() -> None:
    rules = [SubjectRules("/s", (rule("ros_topic", ["ros_publish"], ["/t"]),))]
    known = Edge("/s", "publish", Object("topic", "rt/t"))
    spy = Edge("/s", "publish", Object("topic", "rt/spy"))
    edges = list(
        probes.edges(
            rules,
            probes.common_objects(rules),
            {},
            mentioned=lambda _subject: [known, spy, spy],
            needed=lambda _edge: [known],
        )
    )
    assert edges.count(spy) == 1
    assert known not in edges


def test_objects_without_a_name_on_the_transport_are_not_asked_for() -> None:
    rules = [SubjectRules("/s", (rule("topic", ["publish"], ["t"]), rule("ros_action", ["ros_request"], ["/x"])))]
    assert {edge.object.kind for edge in edges_of(rules, {})} > {
        "topic",
        "ros_action",
    }
    kinds = {"ros_topic", "ros_service", "ros_action"}
    assert {edge.object.kind for edge in edges_of(rules, {}, lambda object_: object_.kind in kinds)} == kinds
