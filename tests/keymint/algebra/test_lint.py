"""What in a policy is in vain."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.algebra.lint import CODES, lint
from tests.keymint.algebra.policies import deny, loaded, profile, rule

PUB = ("ros_topic", "ros_publish")


def found(folder: Path, *profiles: str) -> list[tuple[str, int]]:
    policy = loaded(folder, *profiles)
    said = lint(policy)
    assert all(each.code in CODES and each.help and each.where for each in said)
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


def test_partitions_are_part_of_what_a_rule_is_about(tmp_path: Path) -> None:
    narrowed = rule("topic", "publish", "a").replace(
        "</topic>", "<partitions><partition>p</partition></partitions></topic>"
    )
    assert found(tmp_path, profile("/s", rule("topic", "publish", "a"), narrowed)) == []
    assert found(tmp_path, profile("/s", narrowed, narrowed)) == [("rule-redundant", 4)]


def test_only_what_is_in_vain_for_every_subject(tmp_path: Path) -> None:
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
def test_names_that_are_nearly_alike(tmp_path: Path, published: str, subscribed: str, near: bool) -> None:
    policy = profile("/a", rule(*PUB, published)), profile("/b", rule("ros_topic", "ros_subscribe", subscribed))
    assert found(tmp_path, *policy) == ([("name-similar", 3)] if near else [])


def test_a_third_name_that_somebody_is_at_the_other_end_of_is_no_slip(tmp_path: Path) -> None:
    both = profile("/c", rule("ros_topic", "ros_publish ros_subscribe", "/chatter"))
    assert found(tmp_path, both, profile("/a", rule(*PUB, "/chater"))) == []
