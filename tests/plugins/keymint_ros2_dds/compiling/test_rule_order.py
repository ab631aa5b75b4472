# SPDX-License-Identifier: Apache-2.0
"""The order of rules that every vendor reads in the same way."""

from __future__ import annotations

import itertools
import random

from tests.effort import tries
from tests.plugins.keymint_ros2_dds.builds import CHATTER, build, codes, shape
from tests.plugins.keymint_ros2_dds.packages import rule


def test_a_denial_comes_before_what_it_punctures_and_an_allow_rule_stands_at_both_ends():
    found = shape(
        rule("ALLOW", "ros_topic", "ros_publish", "/a*", "/chatter"), rule("DENY", "ros_topic", "ros_publish", "/ab")
    )
    assert found == [
        ("allow_rule", {"publish": ["rt/chatter"]}),
        ("deny_rule", {"publish": ["rt/ab"]}),
        ("allow_rule", {"publish": ["rt/a*"]}),
    ]
    found = shape(rule("ALLOW", "topic", "publish", "*"), rule("DENY", "topic", "publish", "x"))
    assert found == [("allow_rule", {}), ("deny_rule", {"publish": ["x"]}), ("allow_rule", {"publish": ["*"]})]


def test_a_name_that_only_one_direction_denies_is_allowed_before_it_is_denied():
    found = shape(
        rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/*"),
        rule("DENY", "ros_topic", "ros_publish", "/estop"),
    )
    assert found[0] == ("allow_rule", {"subscribe": ["rt/*"]})
    assert found[1] == ("deny_rule", {"publish": ["rt/estop"]})


def test_what_has_no_effect_is_left_out():
    found = shape(
        rule("ALLOW", "ros_topic", "ros_publish", "/a", "/a*", "/secret", "/a"),
        rule("DENY", "ros_topic", "ros_publish", "/secret", "/nothing*"),
        rule("DENY", "ros_topic", "ros_subscribe", "/a"),
    )
    assert found == [("allow_rule", {"publish": ["rt/a*"]})]


def test_relay_stands_by_itself_at_the_end():
    built = build(
        CHATTER, rule("ALLOW", "ros_topic", "ros_relay", "/r*"), rule("DENY", "ros_topic", "ros_relay", "/rx")
    )
    found = shape(
        CHATTER, rule("ALLOW", "ros_topic", "ros_relay", "/r*"), rule("DENY", "ros_topic", "ros_relay", "/rx")
    )
    assert found[1:] == [("deny_rule", {"relay": ["rt/rx"]}), ("allow_rule", {"relay": ["rt/r*"]})]
    assert "vendor-relay" in codes(built.diagnostics)


def test_the_documents_do_not_depend_on_the_order_of_the_rules():
    rules = [
        CHATTER,
        rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/a*", "*b"),
        rule("DENY", "ros_topic", "ros_publish", "/ab*", "/a/x"),
        rule("DENY", "ros_topic", "ros_subscribe", "/*x"),
        rule("ALLOW", "topic", "publish", "p*", "q*", partitions=["q", "p"]),
        rule("ALLOW", "topic", "publish", "*pq", "*qq"),
    ]
    orders = list(itertools.permutations(rules))
    some = random.Random("order").sample(orders, tries(60, len(orders)))
    documents = {build(*order).documents["permissions.xml"] for order in some}
    assert len(documents) == 1


def test_partitions_elsewhere_do_not_change_what_is_said_of_other_topics():
    both = rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/*")
    deny = (rule("DENY", "ros_topic", "ros_publish", "/a*"), rule("DENY", "ros_topic", "ros_subscribe", "/*b"))
    elsewhere = rule("ALLOW", "topic", "publish", "p*", partitions=["q"])
    assert shape(both, *deny, elsewhere) == [("allow_rule", {"publish": ["p*"]}), *shape(both, *deny)[1:]]
