# SPDX-License-Identifier: Apache-2.0
"""Rules are written as a policy, which is read again."""

from __future__ import annotations

import pytest
from keymint_ros2_comarmor import policy_type

from comarmor.errors import ComArmorError, Origin
from comarmor.rules import KIND_OF, Effect, Rule
from keymint.ir import SubjectRules

PLACE = Origin("permissions.p7s", 14)


def rule(effect: Effect, permission: str, *names: str, partitions: tuple[str, ...] = ()) -> Rule:
    return Rule(effect, KIND_OF[permission], (permission,), names, partitions, False, PLACE)


def test_the_fewest_rules_are_written_and_read_again() -> None:
    rules = (
        rule(Effect.DENY, "ros_publish", "/secret*"),
        rule(Effect.ALLOW, "ros_subscribe", "/a"),
        rule(Effect.ALLOW, "ros_publish", "/a", "/b\\{c\\}"),
        rule(Effect.ALLOW, "publish", "x\\ y", partitions=("", "p*")),
        rule(Effect.DENY, "publish", "z", partitions=("",)),
    )
    document, (first, second) = policy_type.policy_of(
        [SubjectRules("/r/a", rules), SubjectRules("/b", ())], "new.xml", "a -- b"
    )
    assert b"<!-- a - - b -->" in document
    assert [(r.effect, r.permissions, r.expressions, r.partitions) for r in first.rules] == [
        (Effect.ALLOW, ("publish",), ("x\\ y",), ("", "p*")),
        (Effect.ALLOW, ("ros_publish",), ("/b\\{c\\}",), ()),
        (Effect.ALLOW, ("ros_publish", "ros_subscribe"), ("/a",), ()),
        (Effect.DENY, ("publish",), ("z",), ("",)),
        (Effect.DENY, ("ros_publish",), ("/secret*",), ()),
    ]
    assert first.rules[0].origin.file == "new.xml"
    assert second == SubjectRules("/b", ())


def test_what_a_policy_cannot_hold_is_refused() -> None:
    long = SubjectRules("/a", (rule(Effect.ALLOW, "publish", "x" * 5000),))
    with pytest.raises(ComArmorError, match=r"permissions\.p7s:14: has a name of more than 4,096 characters"):
        policy_type.policy_of([long], "new.xml")
    with pytest.raises(ComArmorError, match="is not a legal name of a subject"):
        policy_type.policy_of([SubjectRules("/a b", ())], "new.xml")
