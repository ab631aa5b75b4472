# SPDX-License-Identifier: Apache-2.0
"""Decision lists of documents and policies, compared with the decision point and with the definition."""

from __future__ import annotations

import ctypes
import itertools
import re

import pytest
from hypothesis import assume, example, given, settings, strategies as st
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator
from keymint_ros2_dds.decision.semantics import VARIATIONS
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.proving import document_lists, questions
from keymint_ros2_dds.proving.octets import read
from keymint_ros2_dds.reading import dialects, signed_permissions

from comarmor.patterns.evaluate import permits
from comarmor.patterns.glob import matches
from comarmor.patterns.tokens import PatternError
from keymint.ir import SubjectRules
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import DENIED, PARTITIONS, rules
from tests.plugins.keymint_ros2_dds.decision import documents as xml
from tests.plugins.keymint_ros2_dds.decision.cyclone_reference import cyclone_regex
from tests.plugins.keymint_ros2_dds.oracles import policy as oracle

EXPRESSIONS = st.lists(
    st.sampled_from(["a", "b", "*", "?", "[a]", "[!a]", "[a-b]", "[ab", "\\a", "]", "a"]), min_size=1, max_size=4
).map("".join)
NAMES = ["".join(word) for size in range(1, 4) for word in itertools.product("ab]", repeat=size)] + ["\\a", "a\\ab"]
ASKED = ["", "p", "q", "*"]


@st.composite
def grants(draw):
    def criteria():
        action = draw(st.sampled_from(["publish", "subscribe", "publish", "relay"]))
        partitions = draw(st.sampled_from([None, None, ("",), ("p",), ("p", "q"), ("*",), ("?",)]))
        topics = draw(st.lists(EXPRESSIONS, min_size=1, max_size=2))
        return xml.criteria(action, *topics, partitions=partitions, tags=draw(st.sampled_from(["", "", "", "t"])))

    def rule():
        effect = draw(st.sampled_from(["allow", "allow", "deny"]))
        bodies = sorted(criteria() for _ in range(draw(st.integers(1, 2))))
        bodies.sort(key=lambda body: ["<pub", "<sub", "<rel"].index(body.strip()[:4]))
        return xml.rule(effect, *bodies, domains=draw(st.sampled_from(["<id>0</id>", "<id>0</id>", "<id>1</id>"])))

    drawn = [rule() for _ in range(draw(st.integers(1, 4)))]
    return xml.document(xml.grant(*drawn, default=draw(st.sampled_from(["DENY", "DENY", "ALLOW"]))))


@pytest.mark.parametrize("model", ["omg", "cyclonedds-0.10", "fastdds-2.9"])
@settings(max_examples=tries(75, 150), deadline=None)
@given(grants())
def test_lists_of_a_grant_say_what_the_decision_point_says(model, content):
    document = signed_permissions.read(content)
    variation = VARIATIONS[model]
    judge = DocumentEvaluator(document, xml.SUBJECT, xml.NOW, 0, variation)
    for action in ("publish", "subscribe"):
        found = document_lists.of_grant(document.grants[0], 0, action, variation.semantics, pairs=True)
        plain = document_lists.of_grant(document.grants[0], 0, action, variation.semantics, pairs=False)
        for name, partition in itertools.product(NAMES, ASKED):
            expected = judge.decide(action, name, (partition,)).allowed
            assert all(permits(each, f"{partition}\0{name}") for each in found) == expected, (action, name, partition)
            if not partition:
                assert all(permits(each, name) for each in plain) == expected, (action, name)


@settings(max_examples=tries(75, 150), deadline=None)
@given(grants(), st.booleans())
def test_the_decision_point_lies_between_the_bounds_of_a_model(content, pairs):
    """What lists that must all permit cannot say exactly: a topic that either direction may create."""
    document = signed_permissions.read(content)
    for variation in VARIATIONS.values():
        judge = DocumentEvaluator(document, xml.SUBJECT, xml.NOW, 0, variation)
        bounds = variation.semantics.bounds
        for action, name, partition in itertools.product(("publish", "subscribe"), NAMES, ASKED if pairs else [""]):
            word = f"{partition}\0{name}" if pairs else name
            lists = [document_lists.of_grant(document.grants[0], 0, action, each, pairs=pairs) for each in bounds]
            least, most = (all(permits(each, word) for each in of) for of in (lists[0], lists[-1]))
            allowed = judge.decide(action, name, (partition,)).allowed
            assert least <= allowed <= most, (variation.name, action, name, partition)


@settings(max_examples=tries(75, 150), deadline=None)
@given(grants())
@example(xml.document(xml.grant(xml.rule("allow", xml.criteria("publish", "*")), default="ALLOW")))
def test_partitions_are_left_out_only_where_nothing_is_permitted_in_any(content):
    document = signed_permissions.read(content)
    if document_lists.has_partitions(lower(SubjectRules("/talker", ()), "jazzy"), document.grants):
        return
    for variation in VARIATIONS.values():
        judge = DocumentEvaluator(document, xml.SUBJECT, xml.NOW, 0, variation)
        for action, name, partition in itertools.product(("publish", "subscribe"), NAMES, ASKED[1:]):
            assert not judge.decide(action, name, (partition,)).allowed, (variation.name, action, name, partition)


LIBC = ctypes.CDLL(None)


def _libc(flags):
    return lambda expression, name: LIBC.fnmatch(expression.encode(), name.encode(), flags) == 0


def _cyclone(expression, name):
    return re.fullmatch(cyclone_regex(expression), name, re.DOTALL) is not None


@pytest.mark.parametrize(
    ("dialect", "oracle"),
    [
        pytest.param(dialects.STANDARD, _libc(0), id="standard"),
        pytest.param(dialects.FAST_DDS, _libc(2), id="Fast DDS"),
        pytest.param(dialects.CYCLONE_DDS, _cyclone, id="Cyclone DDS"),
    ],
)
@settings(max_examples=tries(60, 300), deadline=None)
@given(st.text(alphabet="ab*?[]!-\\", max_size=7))
@example("[a]-b")
@example("[!]a]")
@example("[c-a]")
def test_expressions_become_what_the_dialect_matches(dialect, oracle, expression):
    assume(
        dialect is dialects.CYCLONE_DDS or not expression.endswith("-")
    )  # glibc reads a range in an unclosed bracket
    try:
        (pattern,) = read((expression,), dialect)
    except PatternError:
        return  # implementations read it differently
    for name in (*NAMES, "", "-", "!", "[", "a-", "]-b", "a-b", "b!", "[a", "^", "\\"):
        assert matches(pattern, name) == oracle(expression, name), name


TOPICS = [f"rt/{name}" for name in ("", "a", "b", "ab", "a/b", "/", "aab")] + [
    "rq/aRequest", "rr/aReply", "rq/Request", "rt", "rtx/a", "x", "rq/a/bRequest", "rt/c",
]  # fmt: skip


@settings(max_examples=tries(60, 200), deadline=None)
@given(st.lists(st.one_of(rules(), rules(PARTITIONS), rules(DENIED)), max_size=4))
def test_lists_of_a_policy_say_what_its_rules_say(drawn):
    told = SubjectRules("/talker", tuple(drawn))
    lowered = lower(told, "jazzy")
    for action in ("publish", "subscribe"):
        found = document_lists.of_policy(lowered, action, pairs=True)
        plain = document_lists.of_policy(lowered, action, pairs=False)
        for topic, partition in itertools.product(TOPICS, ("", "p", "r", "*")):
            expected = oracle(told, action, topic, (partition,) if partition else ())
            rule = questions.deciding_rule(told, "jazzy", action, topic, partition)
            assert (rule is not None and rule.effect == "ALLOW") == expected
            assert permits(found, f"{partition}\0{topic}") == expected
            if not partition:
                assert permits(plain, topic) == expected
