# SPDX-License-Identifier: Apache-2.0
"""Gathering topics into bracket expressions changes no decision."""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator
from unittest import mock

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_dds.compiling import grant_compiler, rewriting
from keymint_ros2_dds.compiling.rewriting import GUARD, gathered_rules
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, GrantRule

from comarmor.errors import Severity
from comarmor.rules import Effect
from keymint.api import BuildOptions, Hint
from keymint.api.graph import Edge, Object
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import (
    ASKED,
    FEW,
    TOPICS,
    rules,
)
from tests.plugins.keymint_ros2_dds.emit.test_emission import (
    MIXED,
    PLAIN,
    TOPIC,
    document,
    held_against_the_policy,
    hint_lists,
    tags,
    topics,
)
from tests.plugins.keymint_ros2_dds.packages import package, rule


@pytest.fixture
def always_gathered() -> Iterator[None]:
    """Gather wherever it is possible, however little it saves."""
    with mock.patch.object(grant_compiler, "gathered_rules", functools.partial(gathered_rules, min_saved=-(10**6))):
        yield


@settings(max_examples=tries(50, 100))
@given(st.lists(rules(), min_size=1, max_size=6), hint_lists())
def test_gathering_changes_no_decision(drawn, hints):
    with mock.patch.object(grant_compiler, "gathered_rules", functools.partial(gathered_rules, min_saved=-(10**6))):
        held_against_the_policy(drawn, BuildOptions(hints=hints), TOPICS, ((),))


@settings(max_examples=tries(30, 60))
@given(MIXED)
def test_gathering_keeps_partitions(drawn):
    with mock.patch.object(grant_compiler, "gathered_rules", functools.partial(gathered_rules, min_saved=-(10**6))):
        held_against_the_policy(drawn, BuildOptions(), FEW, ASKED)


@settings(max_examples=tries(60, 200))
@given(
    st.lists(st.lists(st.text("ab", min_size=3, max_size=5), max_size=60), min_size=1, max_size=3), st.integers(0, 900)
)
def test_names_are_left_as_they_are_early_only_where_gathering_saves_too_little(drawn, saved):
    form = tuple(
        GrantRule(effect, DEFAULT, {"publish": tuple(sorted(set(texts)))})
        for effect, texts in zip(itertools.cycle([Effect.ALLOW, Effect.DENY]), drawn, strict=False)
        if texts
    )
    early = gathered_rules(form, min_saved=saved)
    with mock.patch.object(rewriting, "_most_shared", return_value=saved):
        assert gathered_rules(form, min_saved=saved) == early


class TestGathering:
    AXLES = tuple(f"/axle{number:03}" for number in range(200))

    def test_names_that_differ_in_a_digit_share_an_expression(self) -> None:
        content = document(package(rule("ALLOW", *TOPIC, *self.AXLES)))
        (pattern,) = topics(content, "allow_rule/publish/topics/topic")
        assert re.fullmatch(r"rt/axle\[01\]\[0123456789\]\[0123456789\]", pattern)
        assert topics(content, "deny_rule/publish/topics/topic") == ["*]*"]

    def test_an_allow_rule_stands_first_and_last(self) -> None:
        assert tags(document(package(rule("ALLOW", *TOPIC, *self.AXLES)))) == ["allow_rule", "deny_rule", "allow_rule"]

    def test_what_saves_little_is_left_as_it_is(self) -> None:
        content = document(package(rule("ALLOW", *TOPIC, *self.AXLES[:9])))
        assert topics(content) == [f"rt{name}" for name in self.AXLES[:9]]

    def test_a_name_that_the_other_direction_denies_stays_in_its_place(self) -> None:
        denied = rule("DENY", "ros_topic", "ros_subscribe", "/axle007")
        hears = rule("ALLOW", "ros_topic", "ros_subscribe", "/axle*")
        content = document(package(rule("ALLOW", *TOPIC, *self.AXLES), denied, hears))
        assert "rt/axle007" in topics(content, "allow_rule/publish/topics/topic")

    def test_a_note_says_who_may_not_know_bracket_expressions(self) -> None:
        found = build_type.build(package(rule("ALLOW", *TOPIC, *self.AXLES)), BuildOptions()).diagnostics
        assert [(each.code, each.severity) for each in found] == [("vendor-wildcard", Severity.NOTE)]
        assert "--no-optimise" in found[0].help

    def test_hints_do_not_overtake_the_guard(self) -> None:
        relays = rule("ALLOW", "ros_topic", "ros_relay", "/axle001")
        loaded = package(rule("ALLOW", *TOPIC, *self.AXLES), relays)
        edge = Edge("/talker", "ros_publish", Object("ros_topic", "/axle001"))
        built = build_type.build(loaded, BuildOptions(hints=(Hint(edge, 9),)))
        assert "rewriting-unproven" not in [found.code for found in built.diagnostics]
        assert GUARD in topics(built.documents["permissions.xml"])

    def test_a_document_that_broke_handshakes_fits(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, *(f"/cell{n % 4}/sensor_{n:04}" for n in range(2000))))
        codes = [each.code for each in build_type.build(loaded, PLAIN).diagnostics]
        assert codes == ["size-permissions"]
        assert "size-permissions" not in [each.code for each in build_type.build(loaded, BuildOptions()).diagnostics]
