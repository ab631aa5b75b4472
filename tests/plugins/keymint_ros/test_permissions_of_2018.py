# SPDX-License-Identifier: Apache-2.0
"""What permissions of 2018 said and the policy does not is told before they are replaced."""

from __future__ import annotations

import pytest
from keymint_ros import package_type
from keymint_ros.package_writer import _differences_of_2018 as differences

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.ir import Rule, SubjectRules


def rule(effect: Effect, kind: str, permissions: tuple[str, ...], *expressions: str, partitions=()) -> Rule:
    return Rule(effect, kind, permissions, expressions, partitions, audit=False, origin=Origin("p.xml", 1))


RULES = SubjectRules(
    "/talker",
    (
        rule(Effect.ALLOW, "ros_topic", ("ros_publish", "ros_subscribe"), "/chatter", "/clock"),
        rule(Effect.ALLOW, "ros_service", ("ros_call",), "/talker/*"),
        rule(Effect.DENY, "topic", ("publish",), "raw", partitions=("p",)),
    ),
)
DOCUMENT = """<package><permissions><grant name="talker">
<deny_rule><publish><topics><topic>raw</topic></topics><partitions><partition>p</partition></partitions></publish>
</deny_rule>
<allow_rule>
<ros_subscribe><ros_topics><ros_topic>/chatter</ros_topic><ros_topic>/clock</ros_topic></ros_topics></ros_subscribe>
<ros_call><ros_services><ros_service>/talker/*</ros_service></ros_services></ros_call>
<ros_publish><ros_topics><ros_topic>/chatter</ros_topic><ros_topic>/clock</ros_topic></ros_topics></ros_publish>
</allow_rule>
<default>DENY</default>
</grant></permissions></package>
"""


def said(old: str = "", new: str = "") -> list[str]:
    assert old in DOCUMENT
    content = DOCUMENT.replace(old, new, 1) if old else DOCUMENT
    return [f"{each.where}: {each.message}" for each in differences(content.encode(), "talker/permissions.xml", RULES)]


def test_the_same_rules_in_another_order() -> None:
    assert said() == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "<ros_topic>/clock</ros_topic></ros_topics></ros_publish>",
            "<ros_topic>/a</ros_topic><ros_topic>/clock</ros_topic><ros_topic>/b</ros_topic></ros_topics></ros_publish>",
            ":7: the permissions of 2018 said ALLOW ros_publish '/a' and 1 more, which the policy does not say",
        ),
        (
            "<ros_topic>/clock</ros_topic></ros_topics></ros_publish>",
            "</ros_topics></ros_publish>",
            ": the permissions of 2018 did not say ALLOW ros_publish '/clock', which the policy says",
        ),
        (
            "<partition>p</partition>",
            "<partition>p</partition><partition>q</partition>",
            ":2: the permissions of 2018 said DENY publish 'raw' in 'p', 'q', which the policy does not say",
        ),
        (
            '<grant name="talker">',
            '<grant name="talker"><subject_name>CN=x</subject_name>',
            ":1: the permissions of 2018 had <subject_name> of its own, which the new one has not",
        ),
        (
            "<default>DENY",
            "<default>ALLOW",
            ":9: the permissions of 2018 had <default> of its own, which the new one has not",
        ),
        (
            "<allow_rule>",
            "<allow_rule><domains><id>5</id></domains>",
            ":4: the permissions of 2018 had <domains> of its own, which the new one has not",
        ),
        (
            "</partitions>",
            "</partitions><data_tags><tag><name>a</name><value>b</value></tag></data_tags>",
            ":2: the permissions of 2018 had <data_tags> of its own, which the new one has not",
        ),
    ],
)
def test_a_difference(old: str, new: str, message: str) -> None:
    assert f"talker/permissions.xml{message}" in said(old, new)


def test_only_documents_of_2018_are_compared() -> None:
    files = {"permissions.xml": DOCUMENT.encode()}
    other = SubjectRules("/talker", ())
    (warning,) = package_type.former_rules(other, files)
    assert warning.message.endswith("said DENY publish 'raw' in 'p' and 5 more, which the policy does not say")
    assert "permissions.xml.2018" in warning.help
    assert package_type.former_rules(RULES, files) == ()
    for content in (b"", b"<package", b"<package/>"):
        assert package_type.former_rules(other, {"permissions.xml": content}) == ()
    assert package_type.former_rules(other, {**files, "keymint_package.xml": b"<package"}) == ()
