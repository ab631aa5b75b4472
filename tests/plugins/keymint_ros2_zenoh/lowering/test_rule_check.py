# SPDX-License-Identifier: Apache-2.0
"""Rules that Zenoh cannot express are errors with their place; others that deserve attention are warnings."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_zenoh.lowering.key_rules import check_rules

from comarmor.errors import Severity
from comarmor.rules import Rule

from .policies import rule, subject_rules

BOTH = ["ros_publish", "ros_subscribe"]


def codes(*rules: Rule, distro: str = "jazzy") -> list[tuple[str, Severity, int]]:
    return [
        (each.code, each.severity, each.where.line if each.where else 0)
        for each in check_rules(subject_rules(*rules), distro)
    ]


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "lyrical", "rolling"])
def test_rules_without_findings(distro: str) -> None:
    assert codes(rule("ALLOW", "ros_topic", BOTH, "/a*", "/b"), distro=distro) == []


@pytest.mark.parametrize("distro", ["ardent", "foxy", "galactic", "iron", "jazzi"])
def test_distributions_without_zenoh(distro: str) -> None:
    assert codes(distro=distro) == [("zenoh-distro", Severity.ERROR, 0)]


@pytest.mark.parametrize(
    ("bad", "code"),
    [
        (rule("ALLOW", "topic", ["publish"], "rt/a"), "zenoh-raw-topic"),
        (rule("DENY", "topic", ["publish"], "*"), "zenoh-raw-topic"),
        (rule("ALLOW", "ros_topic", ["ros_publish", "ros_relay"], "/a"), "zenoh-relay"),
        (rule("ALLOW", "ros_topic", ["ros_publish"], "/a??"), "zenoh-expression"),
        (rule("ALLOW", "ros_topic", ["ros_publish"], "/a\\"), "expression"),
        (rule("ALLOW", "ros_topic", ["ros_fly"], "/a"), "permission-unknown"),
        (replace(rule("ALLOW", "ros_topic", ["ros_publish"], "/a"), partitions=("p",)), "zenoh-partition"),
    ],
)
def test_what_zenoh_cannot_express(bad: Rule, code: str) -> None:
    later = rule("ALLOW", "ros_topic", ["ros_relay"], "/a", line=9)
    assert codes(rule("ALLOW", "ros_topic", BOTH, "/x", line=3), bad, later) == [
        (code, Severity.ERROR, 1),
        ("zenoh-relay", Severity.ERROR, 9),
    ]


def test_expressions_that_match_no_name() -> None:
    assert codes(rule("ALLOW", "ros_topic", BOTH, "a", "/b")) == [("never-matches", Severity.WARNING, 1)]


@pytest.mark.parametrize(
    ("allowed", "denied", "found"),
    [
        ("/*", "/secret", True),
        ("/a*", "/*b", True),
        ("/secret", "/*", False),
        ("/secret/*", "/secret/*", False),
        ("/a/*", "/b/*", False),
        ("/r[12]/*", "/r2/*", False),
        ("/r*/scan", "/r2/*", True),
    ],
)
def test_a_denial_under_a_wildcard_holds_for_names_only(allowed: str, denied: str, found: bool) -> None:
    allowing = rule("ALLOW", "ros_topic", BOTH, allowed, line=1)
    expected = [("zenoh-deny-wildcard", Severity.WARNING, 2)] if found else []
    assert codes(allowing, rule("DENY", "ros_topic", ["ros_publish"], denied, line=2)) == expected
    assert codes(allowing, rule("DENY", "ros_topic", ["ros_subscribe"], denied, line=2)) == []
    assert codes(allowing, rule("DENY", "ros_service", ["ros_call"], denied, line=2)) == []


@pytest.mark.parametrize(("called", "found"), [("/*", True), ("/secret", True), ("/other", False)])
def test_cached_data_of_a_denied_topic_reaches_those_that_may_call_a_service_of_its_name(
    called: str, found: bool
) -> None:
    rules = (
        rule("ALLOW", "ros_topic", ["ros_subscribe"], "/*", line=1),
        rule("DENY", "ros_topic", ["ros_subscribe"], "/secret", line=2),
        rule("ALLOW", "ros_service", ["ros_call"], called, line=3),
    )
    assert codes(*rules) == ([("zenoh-deny-wildcard", Severity.WARNING, 2)] if found else [])
