# SPDX-License-Identifier: Apache-2.0
"""Rules about the wrong objects."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.analysis.lint_rules import lint
from keymint.analysis.object_mistakes import MOST_QUESTIONS
from tests.keymint.analysis.policies import deny, loaded, profile, rule
from tests.keymint.analysis.test_lint_rules import found

SERVES = rule("ros_service", "ros_execute", "{namespace}{name}/get_parameters", "{namespace}{name}/set_parameters")


@pytest.mark.parametrize(
    ("kind", "permission", "name", "is_wide"),
    [
        ("ros_topic", "ros_publish", "*", True),
        ("ros_topic", "ros_publish ros_subscribe", "/*", True),
        ("ros_service", "ros_call", "/?*", True),
        ("topic", "publish", "*", True),
        ("ros_parameter", "ros_read ros_write", "/*", True),
        ("ros_topic", "ros_subscribe", "*", False),
        ("ros_parameter", "ros_read", "/*", False),
        ("ros_topic", "ros_publish", "/camera/*", False),
        ("ros_service", "ros_call", "*/describe", False),
    ],
)
def test_more_than_reading_on_every_object(
    tmp_path: Path, kind: str, permission: str, name: str, is_wide: bool
) -> None:
    assert found(tmp_path, profile("/s", rule(kind, permission, name))) == ([("object-any", 3)] if is_wide else [])


def test_a_right_on_every_object_that_is_meant_is_marked_by_audit(tmp_path: Path) -> None:
    meant = rule("ros_topic", "ros_publish", "*").replace('qualifier="ALLOW"', 'qualifier="ALLOW" modifier="AUDIT"')
    assert "AUDIT" in meant
    assert found(tmp_path, profile("/s", meant)) == []


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("/detector", ""),
        ("/detector/threshold", "/detector"),
        ("/detector/filter/gain", "/detector"),
        ("/detector/*", "/detector"),
        ("/detecter", "/detector"),
        ("/elsewhere", ""),
        ("/*", ""),
        ("/detector2", ""),
        ("/detector_2/x", ""),
    ],
)
def test_a_parameter_where_a_node_is_expected(tmp_path: Path, name: str, near: str) -> None:
    policy = profile("/detector", SERVES), profile("/s", rule("ros_parameter", "ros_read", name))
    said = lint(loaded(tmp_path, *policy))
    assert [(each.code, each.help) for each in said] == (
        [("parameter-object", f"did you mean {near!r}?")] if near else []
    )


def test_a_node_below_another_one_is_no_parameter(tmp_path: Path) -> None:
    nodes = profile("/robot", SERVES), profile("/robot/camera", SERVES)
    assert found(tmp_path, *nodes, profile("/s", rule("ros_parameter", "ros_read", "/robot/camera"))) == []
    assert found(tmp_path, *nodes, profile("/s", rule("ros_parameter", "ros_read", "/robot/*"))) == []


@pytest.mark.parametrize("caller", ["", "/other", "/go", "/g*"])
@pytest.mark.parametrize(
    ("kind", "serve", "call"),
    [("ros_service", "ros_execute", "ros_call"), ("ros_action", "ros_operate", "ros_request")],
)
def test_what_two_serve_and_nobody_calls(tmp_path: Path, kind: str, serve: str, call: str, caller: str) -> None:
    servers = [profile(name, rule(kind, serve, "/go")) for name in ("/a", "/b")]
    callers = [profile("/c", rule(kind, call, caller))] if caller else []
    expected = [("served-twice", 3)] if caller in {"", "/other"} else []
    assert found(tmp_path, *servers, *callers) == expected


@pytest.mark.parametrize("caller", ["/client*", "/*", "/client"])
@pytest.mark.parametrize("denied", [False, True])
def test_who_calls_may_be_a_pattern_of_subjects_or_be_denied(tmp_path: Path, caller: str, denied: bool) -> None:
    servers = [profile(name, rule("ros_service", "ros_execute", "/go")) for name in ("/a", "/b")]
    rules = [rule("ros_service", "ros_call", "/go"), *([deny("ros_service", "ros_call", "/go")] if denied else [])]
    codes = [code for code, _ in found(tmp_path, *servers, profile(caller, *rules))]
    assert ("served-twice" in codes) == denied


def test_a_fleet_of_pairs_is_asked_in_time_that_its_names_take(tmp_path: Path) -> None:
    """All possible subjects are asked about a few names only; a note says so."""
    pairs = [
        profile(f"/r{number}/{name}", rule("ros_service", "ros_execute", f"/r{number}/go"))
        for number in range(MOST_QUESTIONS + 2)
        for name in "ab"
    ]
    codes = [code for code, _ in found(tmp_path, *pairs)]
    assert codes.count("served-twice") == MOST_QUESTIONS + 2
    some = profile("/client*", rule("ros_service", "ros_call", "/elsewhere"))
    codes = [code for code, _ in found(tmp_path, *pairs, some)]
    assert (codes.count("served-twice"), codes.count("lint-unknown")) == (MOST_QUESTIONS, 1)


def test_a_server_alone_is_no_mistake_nor_are_servers_of_a_pattern(tmp_path: Path) -> None:
    assert found(tmp_path, profile("/a", rule("ros_service", "ros_execute", "/go"))) == []
    assert found(tmp_path, *(profile(name, rule("ros_service", "ros_execute", "/go/*")) for name in ("/a", "/b"))) == []
