# SPDX-License-Identifier: Apache-2.0
"""The decision point by the standard, and against the plain oracles on whatever the compiler may write."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, OMG
from keymint_ros2_dds.reading.signed_permissions import read

from tests.effort import tries

from .. import oracles  # noqa: TID252 - helpers of the folder above
from .documents import NOW, SUBJECT, criteria, decide, document, grant, rule

PUBLISH = criteria("publish", "rt/chatter")


def allowed(content: bytes, action: str = "publish", topic: str = "rt/chatter", **more: object) -> bool:
    arguments = {"subject_name": SUBJECT, "now": NOW, "domain": 0, **more}
    return decide(read(content), action=action, topic=topic, **arguments).allowed  # type: ignore[arg-type]


def test_a_rule_decides_with_its_line() -> None:
    content = document(grant(rule("allow", PUBLISH)))
    found = decide(read(content), SUBJECT, NOW, 0, "publish", "rt/chatter")
    assert found.allowed
    assert found.reason == "the allow_rule allows publish 'rt/chatter'"
    assert str(found.where) == "permissions.xml:4"


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ({}, True),
        ({"topic": "rt/other"}, False),
        ({"action": "subscribe"}, False),
        ({"action": "relay"}, False),
        ({"domain": 1}, False),
        ({"partitions": ["p"]}, False),
        ({"partitions": [""]}, True),
        ({"subject_name": "CN=/listener,OU=4f"}, False),
        ({"subject_name": "CN=/talker"}, False),
        ({"now": NOW.replace(year=2028)}, False),
        ({"now": NOW.replace(year=2025)}, False),
    ],
)
def test_what_matters(request_: dict[str, object], expected: bool) -> None:
    assert allowed(document(grant(rule("allow", PUBLISH))), **request_) is expected


def test_the_first_rule_that_matches_decides() -> None:
    allow, deny = rule("allow", criteria("publish", "rt/*")), rule("deny", PUBLISH)
    assert allowed(document(grant(allow, deny)))
    assert not allowed(document(grant(deny, allow)))


@pytest.mark.parametrize(("default", "expected"), [("ALLOW", True), ("DENY", False)])
def test_the_default_decides_what_no_rule_does(default: str, expected: bool) -> None:
    assert allowed(document(grant(default=default))) is expected


def test_an_expired_grant_is_passed_over_for_one_that_is_valid() -> None:
    expired = grant(validity=("2020-01-01T00:00:00", "2021-01-01T00:00:00"))
    assert allowed(document(expired, grant(rule("allow", PUBLISH))))


def test_no_grant_is_an_error_that_says_why() -> None:
    expired = grant(rule("allow", PUBLISH), validity=("2020-01-01T00:00:00", "2021-01-01T00:00:00"))
    found = decide(read(document(expired)), SUBJECT, NOW, 0, "publish", "rt/chatter")
    assert (found.allowed, str(found.where)) == (False, "permissions.xml:2")
    assert "has expired (2020-01-01T00:00:00 to 2021-01-01T00:00:00)" in found.reason
    other = decide(read(document(expired)), "CN=/x", NOW, 0, "publish", "rt/chatter")
    assert other.reason == "no grant applies to 'CN=/x'"


def test_allow_needs_every_partition_and_deny_one() -> None:
    allow = document(grant(rule("allow", criteria("publish", "rt/chatter", partitions=("a", "b")))))
    assert allowed(allow, partitions=["a", "b"])
    assert not allowed(allow, partitions=["a", "c"])
    everything = rule("allow", criteria("publish", "*", partitions=("*",)))
    deny = document(grant(rule("deny", criteria("publish", "rt/chatter", partitions=("a",))), everything))
    assert not allowed(deny, partitions=["a", "c"])
    assert allowed(deny, partitions=["c"])


def test_allow_needs_every_data_tag_and_deny_one() -> None:
    allow = document(grant(rule("allow", criteria("publish", "rt/chatter", tags="a"))))
    assert allowed(allow, tags=[("a", "v")])
    assert not allowed(allow, tags=[("a", "v"), ("b", "v")])
    deny = document(grant(rule("deny", criteria("publish", "rt/chatter", tags="a")), rule("allow", PUBLISH)))
    assert not allowed(deny, tags=[("a", "v"), ("b", "v")])
    assert allowed(deny)


TOPICS = st.sampled_from(["rt/a", "rt/b", "rt/ab", "rt/*", "rt/?", "rt/[a-a]*", "*", "rt/[!a-a]", "r?/a"])
LISTS = st.sampled_from([None, ("",), ("p",), ("p", "q"), ("*",), ("p*",), ("", "q")])
CRITERIA = st.builds(
    lambda action, topics, partitions: criteria(action, *topics, partitions=partitions),
    st.sampled_from(["publish", "subscribe"]),
    st.lists(TOPICS, min_size=1, max_size=3),
    LISTS,
)
RULES = st.builds(lambda effect, bodies: rule(effect, *sorted(bodies)), st.sampled_from(["allow", "deny"]),
                  st.lists(CRITERIA, max_size=3))  # fmt: skip
ASKED = [(), ("",), ("p",), ("q", "p"), ("", "p"), ("*",)]


@settings(max_examples=tries(75, 150), deadline=None)
@given(st.lists(RULES, min_size=1, max_size=5))
def test_models_decide_as_the_oracles_do(rules: list[str]) -> None:
    content = document(grant(*rules))
    loaded = read(content)
    for variation, oracle in (
        (OMG, oracles.omg),
        (CYCLONEDDS_0_10, oracles.cyclone),
        (FASTDDS_2_9, oracles.fastdds),
    ):
        evaluator = DocumentEvaluator(loaded, SUBJECT, NOW, 0, variation)
        for topic in ("rt/a", "rt/b", "rt/ab", "rt/]", "x"):
            for action in ("publish", "subscribe"):
                for partitions in ASKED:
                    found = evaluator.decide(action, topic, partitions).allowed
                    assert found == oracle(content, action, topic, partitions), (variation.name, action, topic)


@settings(max_examples=tries(75, 150), deadline=None)
@given(st.lists(RULES, min_size=1, max_size=5), st.sampled_from(["ALLOW", "DENY"]))
def test_many_topics_are_decided_as_one_by_one(rules: list[str], default: str) -> None:
    loaded = read(document(grant(*rules, default=default)))
    for variation in (OMG, CYCLONEDDS_0_10, FASTDDS_2_9):
        evaluator = DocumentEvaluator(loaded, SUBJECT, NOW, 0, variation)
        for topic, action, checked in product(
            ("rt/a", "rt/b", "rt/ab", "rt/]", "x"), ("publish", "subscribe"), (True, False)
        ):
            expected = evaluator.decide(action, topic, topic_checked=checked).allowed
            assert evaluator.allows(action, topic, topic_checked=checked) == expected
