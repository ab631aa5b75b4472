# SPDX-License-Identifier: Apache-2.0
"""The rules of a subject as DDS patterns, by action."""

from __future__ import annotations

import pytest

from comarmor.errors import Severity
from tests.plugins.keymint_ros2_dds.builds import CHATTER, build, codes, refusal, shape
from tests.plugins.keymint_ros2_dds.packages import rule


def test_all_kinds_are_mapped():
    (only,) = shape(
        CHATTER,
        rule("ALLOW", "ros_service", "ros_execute", "/add"),
        rule("ALLOW", "ros_action", "ros_request", "/fib"),
        rule("ALLOW", "ros_parameter", "ros_write", "/node"),
        rule("ALLOW", "topic", "subscribe", "raw"),
    )
    assert only == (
        "allow_rule",
        {
            "publish": [
                "rq/fib/_action/cancel_goalRequest",
                "rq/fib/_action/get_resultRequest",
                "rq/fib/_action/send_goalRequest",
                "rq/node/set_parametersRequest",
                "rq/node/set_parameters_atomicallyRequest",
                "rr/addReply",
                "rt/chatter",
            ],
            "subscribe": [
                "raw",
                "rq/addRequest",
                "rr/fib/_action/cancel_goalReply",
                "rr/fib/_action/get_resultReply",
                "rr/fib/_action/send_goalReply",
                "rr/node/set_parametersReply",
                "rr/node/set_parameters_atomicallyReply",
                "rt/fib/_action/feedback",
                "rt/fib/_action/status",
            ],
        },
    )


def test_a_rule_that_matches_no_name_is_a_warning():
    (found,) = build(CHATTER, rule("ALLOW", "ros_topic", "ros_publish", "chatter", line=9)).diagnostics
    assert (found.code, found.severity, str(found.where)) == ("never-matches", Severity.WARNING, "policy.xml:9")
    assert found.help == "write '/chatter': every ROS name begins with '/'"


def test_a_permission_that_dds_does_not_know_is_refused():
    (found,) = refusal(rule("ALLOW", "topic", "publsh", "x", line=5))
    assert (found.code, found.where.line, found.help) == ("permission-unknown", 5, "did you mean 'publish'?")


@pytest.mark.parametrize("expression", ["a\\", "[[:nope:]]"])
def test_an_expression_that_cannot_be_read_is_refused(expression):
    assert codes(refusal(rule("ALLOW", "topic", "publish", expression))) == ["expression"]
    assert codes(refusal(rule("ALLOW", "topic", "publish", "x", partitions=[expression]))) == ["expression"]
