# SPDX-License-Identifier: Apache-2.0
"""Subjects with a permission, among all possible subjects."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from comarmor.patterns.glob import parse
from keymint.analysis.query import who_can
from keymint.analysis.rule_lists import query_pattern
from keymint.api.graph import Edge, Object
from keymint.names import typed_permission
from tests.keymint.analysis.policies import deny, loaded, profile, rule

PUB = ("ros_topic", "ros_publish")
SUB = ("ros_topic", "ros_subscribe")


def who(folder: Path, policy: str, permission: str, name: str, within: str = "*") -> list[tuple[str, str]]:
    """Return subjects and names; what is uncertain has no subject."""
    kind, permission = typed_permission(permission, name)
    found = who_can(loaded(folder, policy), parse(within), kind, permission, query_pattern(kind, name))
    return [(each.subject, each.word) for each in found]


@pytest.mark.parametrize(
    ("policy", "question", "expected"),
    [
        (profile("/a", rule(*PUB, "/x")), ("publish", "/x"), [("/a", "/x")]),
        (profile("/a", rule(*PUB, "/x/*")), ("publish", "/x/b*"), [("/a", "/x/b")]),
        (profile("/a", rule(*PUB, "/x/*"), deny(*PUB, "/x/b*")), ("publish", "/x/b*"), []),
        (profile("/a", rule(*PUB, "/x/*"), deny(*PUB, "/x/?")), ("publish", "/x/*"), [("/a", "/x/aa")]),
        (profile("/g/*", rule(*PUB, "/x")), ("publish", "/x"), [("/g/x", "/x")]),
        (profile("/g/*", rule(*PUB, "{namespace}x")), ("publish", "/g/h/x"), [("/g/h/a", "/g/h/x")]),
        (profile("/g/*", rule(*PUB, "{namespace}x")), ("publish", "/safety/*"), []),
        (
            profile("*/talker", rule(*PUB, "{namespace}estop")),
            ("publish", "/safety/estop"),
            [("/safety/talker", "/safety/estop")],
        ),
        (profile("*", rule(*PUB, "/own/{name}")), ("publish", "/own/arm"), [("/arm", "/own/arm")]),
        (profile("/g/*", rule(*PUB, "/x"), deny(*PUB, "/*")), ("publish", "/x"), []),
        (profile("/g/*", rule(*PUB, "/x")) + profile("*", deny(*PUB, "/x")), ("publish", "/x"), []),
        (profile("/a", rule("ros_action", "ros_request", "/go")), ("request", "/go"), [("/a", "/go")]),
        (profile("/a", rule("ros_service", "ros_call", "/n/*")), ("read", "/n"), [("/a", "/n")]),
        (profile("/g/*", rule("ros_service", "ros_call", "/n/*")), ("read", "/*"), [("/g/x", "/n")]),
        (
            profile("/a", rule("ros_action", "ros_request", "/go"), deny("ros_service", "ros_call", "*/cancel_goal")),
            ("request", "/go"),
            [],
        ),
        (profile("/a", rule("topic", "publish", "t")), ("publish", "t"), [("/a", "\0t")]),
    ],
)
def test_who(tmp_path: Path, policy: str, question: tuple[str, str], expected: list[tuple[str, str]]) -> None:
    assert who(tmp_path, policy, *question) == expected


def test_each_pattern_has_an_example(tmp_path: Path) -> None:
    # /x/b is an example of both.
    policy = loaded(tmp_path, profile("/[!a]/b", rule(*PUB, "/x")) + profile("/*/b", rule(*PUB, "/x")))
    assert [each.like for each in who_can(policy, parse("*"), *PUB, parse("/x"))] == ["/[!a]/b", "/*/b"]


def test_within_a_pattern_of_subjects(tmp_path: Path) -> None:
    policy = profile("/amr1/nav", rule(*SUB, "/amr2/x")) + profile("/amr2/cam", rule(*SUB, "/amr2/y"))
    assert who(tmp_path, policy, "subscribe", "/amr2/*", "/amr*/nav") == [("/amr1/nav", "/amr2/x")]
    assert who(tmp_path, policy, "subscribe", "/amr2/*", "/amr3/*") == []


EXPRESSIONS = st.sampled_from(
    ["/a", "/a/b", "/a/*", "/*", "*/b", "/[ab]", "/?", "{namespace}b", "/a/{name}", "{namespace}*"]
)
ATTACHED = st.sampled_from(["/a", "/a/b", "/a/*", "*/b", "/*", "/[ab]/b"])
SUBJECTS = ["/a", "/b", "/a/b", "/a/c", "/b/b", "/a/b/b", "/c/d/b"]
NAMES = ["/a", "/b", "/a/b", "/a/a", "/b/b", "/a/b/b", "/c/d/b"]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(ATTACHED, st.sampled_from(["ALLOW", "DENY"]), EXPRESSIONS), min_size=1, max_size=3),
    st.sampled_from(["/*", "/a/*", "/a", "/c*", "/*/b"]),
    st.sampled_from(["/*", "/a/*", "/b", "/c/*"]),
)
def test_no_result_is_a_proof(tmp_path: Path, written: list[tuple[str, str, str]], within: str, name: str) -> None:
    text = "".join(profile(where, rule(*PUB, what, effect=effect)) for where, effect, what in written)
    policy = loaded(tmp_path, text)
    found = list(who_can(policy, parse(within), *PUB, parse(name)))
    for each in found:
        if not each.unknown:
            assert policy.decide(Edge(each.subject, PUB[1], Object(PUB[0], each.word))).allowed
    if not found:
        from comarmor.patterns.glob import matches

        asked_for = [one for one in NAMES if matches(parse(name), one)]
        for subject in SUBJECTS:
            if matches(parse(within), subject):
                assert not any(policy.decide(Edge(subject, PUB[1], Object(PUB[0], one))).allowed for one in asked_for)
