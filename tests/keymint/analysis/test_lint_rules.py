# SPDX-License-Identifier: Apache-2.0
"""Unreachable, redundant and suspicious rules."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.analysis.lint_rules import lint
from tests.keymint.analysis.policies import deny, loaded, profile, rule

PUB = ("ros_topic", "ros_publish")


def found(folder: Path, *profiles: str) -> list[tuple[str, int]]:
    policy = loaded(folder, *profiles)
    said = lint(policy)
    assert all(each.help and each.where for each in said)
    return [(each.code, each.where.line) for each in said if each.where]


@pytest.mark.parametrize(
    ("rules", "expected"),
    [
        ([rule(*PUB, "/a"), deny(*PUB, "/*")], [("rule-shadowed", 3)]),
        ([rule(*PUB, "/a", "/b"), deny(*PUB, "/a")], [("rule-shadowed", 3)]),
        ([rule(*PUB, "/a/*"), deny(*PUB, "/a/b")], []),
        ([rule(*PUB, "/a/b"), rule(*PUB, "/a/*")], [("rule-redundant", 3)]),
        ([rule(*PUB, "/a"), rule(*PUB, "/a")], [("rule-redundant", 4)]),
        ([rule(*PUB, "/[ab]"), rule(*PUB, "/a"), rule(*PUB, "/b")], [("rule-redundant", 4), ("rule-redundant", 5)]),
        ([rule(*PUB, "/a/[!b]*"), rule(*PUB, "/a/b*"), rule(*PUB, "/a/*")], [("rule-redundant", 5)]),
        ([rule(*PUB, "/a"), rule("ros_topic", "ros_subscribe", "/a")], []),
        ([rule(*PUB, "/a"), deny(*PUB, "/b")], [("deny-nothing", 4)]),
        ([rule(*PUB, "/a*"), deny(*PUB, "/a?"), deny(*PUB, "/ab")], [("deny-redundant", 5)]),
        ([rule(*PUB, "a")], [("object-never", 3)]),
        ([rule(*PUB, "/a//b")], [("object-never", 3)]),
        ([rule(*PUB, "/1st")], [("object-never", 3)]),
        ([rule(*PUB, "*/a")], []),
        # The parts of an action are services and topics.
        (
            [rule("ros_action", "ros_request", "/go"), rule("ros_service", "ros_call", "/go/_action/send_goal")],
            [("rule-redundant", 4)],
        ),
        ([rule("ros_parameter", "ros_read", "/n"), deny("ros_service", "ros_call", "/n/set_*")], [("deny-nothing", 4)]),
        # A rule without partitions allows in the default one, and denies in all.
        ([rule("topic", "publish", "a"), deny("topic", "publish", "a")], [("rule-shadowed", 3)]),
    ],
)
def test_rules(tmp_path: Path, rules: list[str], expected: list[tuple[str, int]]) -> None:
    assert found(tmp_path, profile("/s", *rules)) == expected


def test_partitions_are_compared(tmp_path: Path) -> None:
    narrowed = rule("topic", "publish", "a").replace(
        "</topic>", "<partitions><partition>p</partition></partitions></topic>"
    )
    assert found(tmp_path, profile("/s", rule("topic", "publish", "a"), narrowed)) == []
    assert found(tmp_path, profile("/s", narrowed, narrowed)) == [("rule-redundant", 4)]


def test_rules_must_be_redundant_for_every_subject(tmp_path: Path) -> None:
    shared = profile("/*", rule(*PUB, "/a"))
    assert found(tmp_path, shared, profile("/s", deny(*PUB, "/a")), profile("/t")) == []
    # Nobody but an example of those that /* matches could use the rule.
    assert found(tmp_path, shared, profile("/s", deny(*PUB, "/a"))) == []


def test_attachments_and_profiles(tmp_path: Path) -> None:
    assert found(tmp_path, profile("s/*")) == [("subject-never", 2)]
    assert found(tmp_path, profile("/a/*", profile("/b/*"))) == [("profile-never", 3)]
    assert found(tmp_path, profile("/a/*", profile("*/b"))) == []


def test_tunables(tmp_path: Path) -> None:
    tunable = '<tunable name="R"><value>/r</value></tunable>\n'
    assert found(tmp_path, tunable, profile("/a")) == [("tunable-unused", 2)]
    assert found(tmp_path, tunable, profile("@{R}/a")) == []
    through = '<tunable name="S"><value>@{R}/s</value></tunable>\n'
    assert found(tmp_path, tunable, through, profile("@{S}")) == []
    hidden = f'<profile name="p">{tunable}<attachment>@{{R}}</attachment></profile>'
    assert found(tmp_path, tunable, hidden) == [("tunable-unused", 2)]


@pytest.mark.parametrize(
    ("published", "subscribed", "near"),
    [
        ("/chater", "/chatter", True),
        ("/cmd_vel", "/cmdvel", True),
        ("/robot1/scan", "/robot2/scan", False),
        ("/left_arm", "/right_arm", False),
        ("/chatter", "/chatter", False),
    ],
)
def test_similar_names(tmp_path: Path, published: str, subscribed: str, near: bool) -> None:
    policy = profile("/a", rule(*PUB, published)), profile("/b", rule("ros_topic", "ros_subscribe", subscribed))
    assert found(tmp_path, *policy) == ([("name-similar", 3)] if near else [])


@pytest.mark.parametrize(
    ("published", "is_slip"),
    [("/chater", True), ("/chattre", True), ("/chattter", True), ("/chatted", False), ("/chatters2", False)],
)
def test_a_name_with_a_peer_is_meant_only_by_a_slip(tmp_path: Path, published: str, is_slip: bool) -> None:
    both = profile("/c", rule("ros_topic", "ros_publish ros_subscribe", "/chatter"))
    expected = [("name-similar", 6)] if is_slip else []
    assert found(tmp_path, both, profile("/a", rule(*PUB, published))) == expected


def test_of_similar_names_both_are_offered_since_either_may_be_the_typo(tmp_path: Path) -> None:
    policy = profile("/a", rule(*PUB, "/image")), profile("/b", rule("ros_topic", "ros_subscribe", "/imgae"))
    (said,) = lint(loaded(tmp_path, *policy))
    assert (str(said.where), f"{tmp_path}/policy.xml:6" in said.message) == (f"{tmp_path}/policy.xml:3", True)
    assert "'/image' or '/imgae'" in said.help


SUB = "ros_topic", "ros_subscribe"


def attached(kind: str, permission: str, *names: str, effect: str = "ALLOW") -> str:
    """Return a rule with each attachment on a line of its own, the first one right below the rule's."""
    return rule(kind, permission, *names, effect=effect).replace("<attachment>", "\n<attachment>")


def test_findings_on_some_attachments_have_their_lines(tmp_path: Path) -> None:
    several = attached(*SUB, "/a", "x", "/b", "/c")
    denied = deny(*SUB, "/b")
    assert found(tmp_path, profile("/s", several, denied)) == [("object-never", 5), ("rule-shadowed", 6)]
    # One that is about all of a rule is at the rule.
    assert found(tmp_path, profile("/s", attached(*SUB, "/a", "/b"), deny(*SUB, "/*"))) == [("rule-shadowed", 3)]


def test_values_of_a_tunable_are_one_attachment(tmp_path: Path) -> None:
    tunable = '<tunable name="R"><value>/r</value><value>/q</value></tunable>\n'
    allowed = attached(*SUB, "@{R}/a", "/b")
    (said,) = lint(loaded(tmp_path, tunable, profile("/s", allowed, deny(*SUB, "/?/a"))))
    assert (said.code, str(said.where)) == ("rule-shadowed", f"{tmp_path}/policy.xml:5")
    assert said.message.startswith("'/r/a', '/q/a' in this")


def test_attachments_that_expand_equally_for_one_subject_are_distinguished(tmp_path: Path) -> None:
    # For /s the first two are one expression; /n/s needs the third.
    shared = profile("/*", attached(*SUB, "{namespace}a", "/a", "/b"))
    assert found(tmp_path, shared, profile("/s", rule(*SUB, "/b")), profile("/n/s", rule(*SUB, "/a"))) == [
        ("rule-redundant", 9),
        ("rule-redundant", 12),
    ]


def test_of_names_that_are_similar_twice_the_topic_is_reported(tmp_path: Path) -> None:
    writer = (rule(*PUB, "/cam/images"), rule("ros_service", "ros_call", "/cam/images"))
    readers = rule("ros_topic", "ros_subscribe", "/cam/image", "/cam/imagesxy")
    policy = profile("/a", *writer), profile("/b", readers, rule("ros_service", "ros_execute", "/cam/imagesxy"))
    assert found(tmp_path, *policy) == [("name-similar", 3), ("name-similar", 7)]


def test_similar_subjects(tmp_path: Path) -> None:
    often = profile("/amr1/nav") + profile("/amr1/nav").replace('"/amr1/nav"', '"more"')
    copied = ("profile-copied", 4)
    assert found(tmp_path, often, profile("/amr1/navi")) == [copied, ("name-similar", 6)]
    assert found(tmp_path, often, profile("/amr2/nav")) == [copied]
    assert found(tmp_path, profile("/amr1/nav"), profile("/amr1/navi")) == []


def test_a_profile_that_never_applies_because_of_a_typo(tmp_path: Path) -> None:
    (said,) = lint(loaded(tmp_path, profile("/amr1/nav", profile("/amr1/navi"))))
    assert (said.code, said.help) == ("profile-never", "did you mean '/amr1/nav'?")


def test_a_denial_of_something_allowed_is_not_reported(tmp_path: Path) -> None:
    # The denial makes the rule unreachable. The author must decide which one is meant; it is reported once.
    assert found(tmp_path, profile("/s", deny(*SUB, "/*"), rule(*SUB, "/a"))) == [("rule-shadowed", 4)]


def test_rules_that_depend_on_the_namespace_are_checked_in_a_deeper_one(tmp_path: Path) -> None:
    assert found(tmp_path, profile("/?b*", rule(*SUB, "{namespace}*"), rule(*SUB, "/c"))) == []


def test_a_denial_may_have_an_effect_for_one_subject_of_a_pattern(tmp_path: Path) -> None:
    # To /a alone, which is no example of /*, the denial matters.
    assert found(tmp_path, profile("/*", deny(*SUB, "/a"), rule(*SUB, "/{name}"))) == []
    assert found(tmp_path, profile("/b*", deny(*SUB, "/a"), rule(*SUB, "{namespace}{name}"))) == [("deny-nothing", 3)]


@pytest.mark.parametrize(
    ("denied", "granted", "nothing"),
    [
        ("{namespace}t", "{namespace}u", True),
        ("{namespace}t", "{namespace}*", False),
        ("{namespace}{name}/t", "{namespace}{name}/u", True),
        ("{namespace}private/*", "{namespace}{name}/get", False),
        ("/x/{name}", "/x/{name}/t", True),
        ("/x/{name}", "/x/{namespace}t", False),
    ],
)
def test_rules_that_depend_on_the_subject_in_the_same_way(
    tmp_path: Path, denied: str, granted: str, nothing: bool
) -> None:
    expected = [("deny-nothing", 3)] if nothing else []
    assert found(tmp_path, profile("/r/*", deny(*SUB, denied), rule(*SUB, granted))) == expected
