# SPDX-License-Identifier: Apache-2.0
"""Rules that are read later."""

from __future__ import annotations

import pickle
from dataclasses import replace
from unittest import mock

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules, kind_of

RULES = (Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), ("/chatter",), (), audit=False, origin=Origin("p.xml", 1)),)


def test_rules_are_read_once_when_they_are_asked_for() -> None:
    read = mock.Mock(return_value=RULES)
    deferred = SubjectRules("/talker", read)
    assert deferred.subject == "/talker"
    read.assert_not_called()
    assert deferred.rules == deferred.rules == RULES
    read.assert_called_once()


def test_rules_that_are_read_later_equal_those_that_were_read() -> None:
    deferred, rules = SubjectRules("/talker", lambda: RULES), SubjectRules("/talker", RULES)
    assert deferred == rules == deferred
    assert hash(deferred) == hash(rules)
    assert deferred != SubjectRules("/listener", RULES)
    assert SubjectRules("/talker", ()) != deferred
    assert rules != RULES


def test_the_kind_of_rules_is_made_once() -> None:
    known = kind_of(RULES)
    with mock.patch("keymint.ir.kind_of", side_effect=[known]):
        rules = SubjectRules("/talker", RULES)
        assert rules.kind is rules.kind is known
    deferred = SubjectRules("/talker", mock.Mock(side_effect=AssertionError), known)
    assert deferred.kind is known, "it was known before the rules were read"


def test_another_process_gets_rules_that_were_read() -> None:
    deferred = SubjectRules("/talker", lambda: RULES)
    assert pickle.loads(pickle.dumps(deferred)) == SubjectRules("/talker", RULES)


def test_the_error_of_reading_is_raised_at_each_access() -> None:
    deferred = SubjectRules("/talker", mock.Mock(side_effect=KeymintError("damaged")))
    for _ in range(2):
        with pytest.raises(KeymintError, match="damaged"):
            _ = deferred.rules


EXPRESSIONS = st.sampled_from(["/a", "/b", "/c", "", "/a*", "/?", "/[ab]", r"/\a"])


def rules() -> st.SearchStrategy[list[Rule]]:
    one = st.builds(
        Rule,
        effect=st.sampled_from(Effect),
        kind=st.sampled_from(["topic", "ros_topic"]),
        permissions=st.sampled_from([("publish",), ("subscribe",), ("publish", "subscribe")]),
        expressions=st.lists(EXPRESSIONS, max_size=4).map(tuple),
        partitions=st.sampled_from([(), ("p",), ("/a",)]),
        audit=st.booleans(),
        origin=st.builds(Origin, st.just("policy.xml"), st.integers(1, 9)),
    )
    return st.lists(one, max_size=5)


def renamed(drawn: list[Rule], names: dict[str, str]) -> list[Rule]:
    return [replace(each, expressions=tuple(names.get(text, text) for text in each.expressions)) for each in drawn]


@given(rules())
def test_kind_and_arguments_are_the_rules_without_their_places(drawn: list[Rule]) -> None:
    kind, arguments = kind_of(drawn)
    restored = [
        (
            effect,
            of,
            permissions,
            tuple(arguments[max(each, ~each)] if isinstance(each, int) else each for each in expressions),
            partitions,
            audit,
        )
        for effect, of, permissions, expressions, partitions, audit in kind
    ]
    assert restored == [(r.effect, r.kind, r.permissions, r.expressions, r.partitions, r.audit) for r in drawn]
    assert len(set(arguments)) == len(arguments)
    assert kind_of([replace(each, origin=Origin("elsewhere.xml", 1)) for each in drawn]) == (kind, arguments)


@given(rules(), st.permutations(["/a", "/b", "/c", "/other", ""]))
def test_other_names_are_other_arguments_of_the_same_kind(drawn: list[Rule], to: list[str]) -> None:
    names = dict(zip(["/a", "/b", "/c", ""], to, strict=False)) | {"/a*": "*/long"}
    kind, arguments = kind_of(drawn)
    assert kind_of(renamed(drawn, names)) == (kind, tuple(names[each] for each in arguments))


@given(rules(), rules())
def test_different_rules_differ_in_kind_or_arguments(one: list[Rule], other: list[Rule]) -> None:
    def said(drawn: list[Rule]) -> list[Rule]:
        return [replace(each, origin=Origin("policy.xml", 1)) for each in drawn]

    assert (kind_of(one) == kind_of(other)) is (said(one) == said(other))
