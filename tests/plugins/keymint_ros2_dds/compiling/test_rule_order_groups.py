# SPDX-License-Identifier: Apache-2.0
"""Groups of rules that share no name, and rules merged into others."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.compiling.rule_order import denied_partitions, merged_rules, rule_groups
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, EVERY, GrantRule
from keymint_ros2_dds.lowering.name_mapping import TopicAction
from keymint_ros2_dds.lowering.portable_expressions import UnportableError

from comarmor.patterns.glob import matches, parse
from comarmor.rules import Effect

PUBLISH, SUBSCRIBE = "publish", "subscribe"
NAMES = ["".join(word) for size in range(1, 4) for word in itertools.product("ab", repeat=size)]
PATTERNS = st.lists(st.sampled_from(["a", "b", "*", "?"]), min_size=1, max_size=3).map("".join).map(parse)
LISTS = st.sampled_from([(), ("p",), ("q",), ("p", "q"), ("*",)])
STEPS = st.lists(st.tuples(PATTERNS, LISTS), max_size=4)


def patterns(rules, action=PUBLISH):
    return [pattern for rule in rules for pattern in rule.topics.get(action, ())]


@settings(deadline=None)
@given(STEPS, STEPS)
def test_no_two_groups_allow_the_same_name(allow, deny) -> None:
    try:
        groups = rule_groups(PUBLISH, allow, deny)
    except UnportableError:
        return
    for name in NAMES:
        allowing = [
            group
            for group in groups
            if any(
                matches(pattern, name)
                for rule in (*group.free, *group.ordered)
                if rule.effect is Effect.ALLOW
                for pattern in patterns([rule])
            )
        ]
        assert len(allowing) <= 1
        if any(matches(pattern, name) for pattern, _ in allow) and not any(
            matches(pattern, name) for pattern, _ in deny
        ):
            assert allowing


def test_rules_that_no_denial_overlaps_are_free() -> None:
    allow = [(parse(text), ()) for text in ("a*", "b")]
    (group,) = rule_groups(PUBLISH, allow, [(parse("ab"), ())])
    assert patterns(group.free) == [parse("b")]
    assert [(rule.effect, patterns([rule])) for rule in group.ordered] == [
        (Effect.DENY, [parse("ab")]),
        (Effect.ALLOW, [parse("a*")]),
    ]


def test_patterns_in_other_partitions_are_other_groups() -> None:
    groups = rule_groups(PUBLISH, [(parse("a"), ("p",)), (parse("b"), ("q",)), (parse("c"), ("p",))], [])
    assert [(group.partitions, patterns(group.free)) for group in groups] == [
        (("p",), [parse("a"), parse("c")]),
        (("q",), [parse("b")]),
    ]


def test_patterns_that_overlap_in_other_partitions_are_one_detailed_group() -> None:
    (group,) = rule_groups(PUBLISH, [(parse("a*"), ("p",)), (parse("ab"), ("q",))], [])
    assert group.arrangement is None
    first = next(rule for rule in group.free if parse("ab") in patterns([rule]))
    assert first.partitions == ("p", "q")


@pytest.mark.parametrize(("shared", "denied"), [(DEFAULT, DEFAULT), (("p",), EVERY), (("", "p"), EVERY)])
def test_a_denial_in_the_default_partition_names_no_other(shared, denied) -> None:
    assert denied_partitions(shared) == denied


RULES = st.lists(
    st.builds(
        GrantRule,
        st.sampled_from(list(Effect)),
        st.sampled_from([DEFAULT, ("p",)]),
        st.dictionaries(
            st.sampled_from([PUBLISH, SUBSCRIBE]), st.lists(PATTERNS, min_size=1, max_size=2).map(tuple), min_size=1
        ),
    ),
    max_size=6,
)


def first_match(rules, action: TopicAction, name: str):
    return next(
        (
            (rule.effect, rule.partitions)
            for rule in rules
            if any(matches(p, name) for p in rule.topics.get(action, ()))
        ),
        None,
    )


@given(RULES, st.booleans())
def test_merging_changes_the_rule_of_no_name(rules, across: bool) -> None:
    result = merged_rules(rules, across_effects=across)
    assert len(result) <= len(rules)
    for action, name in itertools.product((PUBLISH, SUBSCRIBE), NAMES):
        assert first_match(result, action, name) == first_match(rules, action, name)
