# SPDX-License-Identifier: Apache-2.0
"""The law of the compiler: for every name, the standard and the vendors decide as the policy does, or it refuses."""

from __future__ import annotations

import itertools

from hypothesis import event, example, given, settings, strategies as st
from keymint_ros2_dds import build_type

from comarmor.errors import Severity
from keymint.api import BuildOptions
from keymint.errors import KeymintError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.builds import CHATTER, LENIENT, build, codes, refusal, shape
from tests.plugins.keymint_ros2_dds.oracles import cyclone, fastdds, omg, policy
from tests.plugins.keymint_ros2_dds.packages import package, rule

PARTS = st.sampled_from(["a", "b", "/", "*", "?", "[ab]", "[!a]"])
NAMES = st.lists(PARTS, min_size=1, max_size=4).map("".join)
ROS = st.one_of(NAMES.map("/{}".format), NAMES)
RAW = st.one_of(
    st.sampled_from(["rt/a", "rt/b", "rt/*", "*", "rt*", "r?/a", "rt/ab", "*a", "rq/*", "x"]),
    NAMES.map("rt/{}".format),
)
KINDS = (
    ("ros_topic", ["ros_publish", "ros_subscribe", "ros_publish ros_subscribe"], ROS),
    ("ros_service", ["ros_call", "ros_execute"], ROS),
    ("topic", ["publish", "subscribe", "publish subscribe"], RAW),
)
WORDS = ["".join(word) for size in range(4) for word in itertools.product("ab/", repeat=size)]
TOPICS = (
    [f"rt/{word}" for word in WORDS]
    + [f"rq/{word}Request" for word in WORDS if len(word) < 3]
    + [f"rr/{word}Reply" for word in WORDS if len(word) < 3]
    + ["rt", "rtx", "rtx/a", "x", "xa", "r", "rt/aaaa", "rt/abab", "rt/baab", "rt/c", "rt/]a", "rt/a]", "rt//", "rq/a"]
)

NO_PARTITIONS = st.just(())


@st.composite
def rules(draw, partitions=NO_PARTITIONS):
    kind, permissions, names = draw(st.sampled_from(KINDS))
    effect = draw(st.sampled_from(["ALLOW", "ALLOW", "DENY"]))
    expressions = draw(st.lists(names, min_size=1, max_size=2))
    listed = draw(partitions) if kind == "topic" else ()
    return rule(effect, kind, draw(st.sampled_from(permissions)), *expressions, partitions=listed)


PARTITIONS = st.lists(st.sampled_from(["", "p", "q", "*"]), max_size=2).map(tuple)
DENIED = st.lists(st.sampled_from(["", "p", "q", "*", "p*", "?"]), max_size=2).map(tuple)
ASKED = ((), ("",), ("p",), ("q",), ("r",), ("p", "q"), ("", "p"), ("p", "r"), ("*",))
FEW = tuple(topic for topic in TOPICS if len(topic) < 6)


def differences(loaded, document: bytes, topics=TOPICS, asked=((),)):
    for action, topic, partitions in itertools.product(("publish", "subscribe"), topics, asked):
        wanted = policy(loaded.grant.rules, action, topic, partitions)
        for vendor in (omg, cyclone, fastdds):
            if vendor(document, action, topic, partitions) != wanted:
                yield vendor.__name__, action, topic, partitions, wanted


def built_or_refused(loaded):
    """Build a package; a refusal must name portability, a place and a help."""
    try:
        return build_type.build(loaded, BuildOptions()).documents["permissions.xml"]
    except KeymintError as error:
        refused = error.diagnostics
    event("refused")
    assert {found.code.split("-")[0] for found in refused} == {"portability"}
    assert all(found.where and found.help for found in refused)
    return None


@settings(max_examples=tries(75, 150), deadline=None)
@given(st.lists(rules(), min_size=1, max_size=6))
def test_every_vendor_decides_as_the_policy_does(drawn):
    loaded = package(*drawn)
    document = built_or_refused(loaded)
    assert document is None or list(differences(loaded, document)) == []


@settings(max_examples=tries(50, 100), deadline=None)
@example(
    [
        rule("ALLOW", "ros_topic", "ros_publish", "/a?"),
        rule("DENY", "ros_topic", "ros_publish", "/a"),
        rule("ALLOW", "topic", "publish", "*a", partitions=("*",)),
    ]
)
@example(
    [
        rule("ALLOW", "topic", "publish", "*", partitions=("p", "q")),
        rule("DENY", "topic", "publish", "a", partitions=("p",)),
    ]
)
@given(st.lists(st.one_of(rules(), rules(PARTITIONS), rules(DENIED)), min_size=1, max_size=5))
def test_partitions_are_decided_as_the_policy_does_or_refused(drawn):
    loaded = package(*drawn)
    document = built_or_refused(loaded)
    assert document is None or list(differences(loaded, document, FEW, ASKED)) == []


def test_a_subject_without_permissions_gets_no_rules_and_a_note():
    assert shape() == []
    assert shape(rule("ALLOW", "ros_topic", "ros_publish", "/a"), rule("DENY", "ros_topic", "ros_publish", "*")) == []
    assert codes(build().diagnostics) == ["no-permissions"]


def test_every_rule_that_cannot_be_said_is_reported_with_its_place():
    bad = [
        rule("ALLOW", "ros_topic", "ros_publish", r"/a\*", line=3),
        rule("ALLOW", "ros_topic", "ros_publish", "/Caf\xe9", line=4),
        CHATTER,
        rule("ALLOW", "ros_topic", "ros_publish", "/[a-z][a-z]*", line=5),
    ]
    found = refusal(*bad)
    assert [(item.code, item.where.line) for item in sorted(found, key=lambda item: item.where.line)] == [
        ("portability-expression", 3),
        ("portability-expression", 4),
        ("portability-expression", 5),
    ]
    assert all(item.severity is Severity.ERROR and item.help and item.subject == "/talker" for item in found)
    lenient = build(*bad, options=LENIENT)
    assert {item.severity for item in lenient.diagnostics if item.code == "portability-expression"} == {
        Severity.WARNING
    }
    assert all("Cyclone DDS and Fast DDS" in i.message for i in lenient.diagnostics if i.code.startswith("portability"))
    assert r"rt/a\*" in lenient.documents["permissions.xml"].decode()


def test_wildcards_before_the_end_are_one_note():
    built = build(rule("ALLOW", "ros_service", "ros_call", "/a*", "/b*"))
    (found,) = built.diagnostics
    assert (found.code, found.severity) == ("vendor-wildcard", Severity.NOTE)
