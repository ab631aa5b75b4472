# SPDX-License-Identifier: Apache-2.0
"""``keymint why``: one decision through all layers."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Outcome

POLICY = """<profiles>
  <profile name="everyone" modifier="AUDIT">
    <attachment>/cell/*</attachment>
    <ros_topic qualifier="DENY">
      <attachment>/estop</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
    <profile name="arm">
      <attachment>/cell/arm</attachment>
      <ros_topic qualifier="ALLOW">
        <attachment>/es*</attachment>
        <permissions><ros_publish/><ros_subscribe/></permissions>
      </ros_topic>
      <ros_action qualifier="ALLOW">
        <attachment>/move</attachment>
        <permissions><ros_request/></permissions>
      </ros_action>
      <topic qualifier="ALLOW">
        <attachment>telemetry</attachment>
        <partitions><partition>ops</partition></partitions>
        <permissions><publish/></permissions>
      </topic>
    </profile>
  </profile>
</profiles>
"""


def line_of(text: str) -> int:
    return next(number for number, line in enumerate(POLICY.splitlines(), 1) if text in line)


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cell")


@pytest.fixture
def why(keymint: Callable[..., Outcome], once: Path, tmp_path: Path) -> Callable[..., Outcome]:
    """Ask in a provisioned workspace."""
    if not (once / "ws").exists():
        (once / "policy.xml").write_text(POLICY)
        outcome = keymint("provision", "policy.xml", "-w", "ws", cwd=once)
        assert outcome.code == 0, outcome.err
    shutil.copytree(once, tmp_path, dirs_exist_ok=True)
    return lambda *arguments: keymint("why", *arguments, "-i", "omg", "-w", "ws")


def test_a_deny_that_decides(why) -> None:
    outcome = why("/cell/arm", "ros_publish", "/estop", "--json")
    assert outcome.code == 0, outcome.out
    result = outcome.document["result"]
    assert result["policy"]["allowed"] is False
    assert result["policy"]["rule"] == {"file": "policy.xml", "line": line_of("DENY"), "included_from": []}
    assert [each["name"] for each in result["profiles"]] == ["everyone", "arm"]
    assert [each["audit"] for each in result["profiles"]] == [True, True]
    assert [each["effect"] for each in result["rules"]] == ["DENY", "ALLOW"]
    assert [each["effect"] for each in result["package"]] == ["DENY", "ALLOW"]
    assert result["endpoints"] == [{"action": "publish", "name": "rt/estop", "partitions": []}]
    (omg,) = result["transports"]
    assert omg["allowed"] is False
    assert omg["rule"]["file"] == "ws/install/enclaves/cell/arm/permissions.xml"


def test_every_place_is_where_the_rule_stands(why, tmp_path: Path) -> None:
    result = why("/cell/arm", "ros_subscribe", "/estop", "--json").document["result"]
    (rule,), (packaged,), (omg,) = result["rules"], result["package"], result["transports"]
    assert rule["rule"]["line"] == line_of("ALLOW")
    source = (tmp_path / packaged["rule"]["file"]).read_text().splitlines()
    assert '<ros_topic qualifier="ALLOW"' in source[packaged["rule"]["line"] - 1]
    document = (tmp_path / omg["rule"]["file"]).read_text().splitlines()
    assert "subscribe" in "".join(document[omg["rule"]["line"] - 1 :])
    assert omg["allowed"] is True


def test_in_words(why) -> None:
    outcome = why("/cell/arm", "ros_publish", "/estop")
    lines = outcome.out.splitlines()
    assert lines[0] == "/cell/arm ros_publish /estop: the policy denies it"
    assert f"decides: DENY ros_topic ros_publish of '/estop' (AUDIT) (policy.xml:{line_of('DENY')})" in outcome.out
    assert "publish on the DDS topic 'rt/estop'" in outcome.out
    assert "denied by omg (ws/install/enclaves/cell/arm/permissions.xml:" in outcome.out


def test_an_action_needs_all_its_parts(why) -> None:
    result = why("/cell/arm", "ros_request", "/move", "--json").document["result"]
    assert result["policy"]["allowed"]
    topics = {each["name"] for each in result["endpoints"]}
    assert {"rq/move/_action/send_goalRequest", "rr/move/_action/send_goalReply", "rt/move/_action/status"} <= topics
    assert len(topics) == 8


def test_partitions(why) -> None:
    inside = why("/cell/arm", "publish", "telemetry", "--partition", "ops", "--json").document["result"]
    outside = why("/cell/arm", "publish", "telemetry", "--json").document["result"]
    assert (inside["policy"]["allowed"], outside["policy"]["allowed"]) == (True, False)
    assert [each["allowed"] for each in inside["transports"] + outside["transports"]] == [True, False]
    assert "'ops'" in outside["nearest"]["note"]


@pytest.mark.parametrize(
    ("request_", "note"),
    [
        (("/cell/arm", "ros_execute", "/move"), "ros_service"),
        (("/cell/arm", "ros_operate", "/move"), "ros_request"),
        (("/cell/arm", "ros_request", "/mov"), "'/move'"),
    ],
)
def test_the_nearest_rule(why, request_: tuple[str, ...], note: str) -> None:
    outcome = why(*request_, "--json")
    result = outcome.document["result"]
    assert result["rules"] == []
    assert note in result["nearest"]["note"]
    assert result["nearest"]["rule"]["line"] == line_of("<ros_action")
    assert "nearest: " in why(*request_).out


def test_a_raw_topic_that_a_ros_rule_is_about(why) -> None:
    """Rules on ROS names and on DDS names meet on the endpoint."""
    result = why("/cell/arm", "subscribe", "rt/estop", "--json").document["result"]
    assert result["policy"]["allowed"]
    assert [each["kind"] for each in result["rules"]] == ["ros_topic"]
    assert result["transports"][0]["allowed"]


@pytest.mark.parametrize(
    ("short", "full"),
    [
        (("cell/arm", "publish", "/estop"), ("/cell/arm", "ros_publish", "/estop")),
        (("/cell/arm", "request", "/move"), ("/cell/arm", "ros_request", "/move")),
        (("/cell/arm", "publish", "telemetry"), ("/cell/arm", "publish", "telemetry", "--kind", "topic")),
    ],
)
def test_words_mean_what_they_mean_in_queries(why, short: tuple[str, ...], full: tuple[str, ...]) -> None:
    assert why(*short).out == why(*full).out


def test_a_raw_topic_that_begins_with_a_slash(why) -> None:
    result = why("/cell/arm", "publish", "/estop", "--kind", "topic", "--json").document["result"]
    assert result["endpoints"] == [{"action": "publish", "name": "/estop", "partitions": []}]


def test_a_subject_without_an_enclave(why) -> None:
    outcome = why("/cell/am", "ros_publish", "/estop")
    assert outcome.code == 0
    assert "did you mean '/cell/arm'?" in outcome.out
    assert "not installed" in outcome.out


def test_a_subject_that_no_profile_applies_to(why) -> None:
    outcome = why("/office/printer", "ros_publish", "/x")
    assert "none applies to /office/printer" in outcome.out


def test_a_transport_that_decides_otherwise(why, keymint, tmp_path: Path) -> None:
    path = tmp_path / "ws/build/cell/arm/permissions.xml"
    path.write_text(path.read_text().replace("<topic>rt/es*<", "<topic>rt/*<"))
    assert keymint("install", "--no-prove", "-w", "ws").code == 0
    outcome = why("/cell/arm", "ros_subscribe", "/other")
    assert outcome.code == 3
    assert "allowed by omg" in outcome.out
    assert "error: false-positive: /cell/arm ros_subscribe /other" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("/cell/arm", "ros_publsh", "/x"), "did you mean 'ros_publish'?"),
        (("/cell/arm", "ros_publish", "x"), "did you mean '/x', or the raw topic 'x' by --kind topic?"),
        (("/cell/arm", "ros_publish", "/x", "--partition", "p"), "only a topic has partitions"),
    ],
)
def test_usage(why, arguments: tuple[str, ...], expected: str) -> None:
    outcome = why(*arguments)
    assert outcome.code == 2
    assert expected in outcome.err


def test_it_asks_in_the_domain_of_the_subject(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(POLICY)
    assert keymint("provision", "p.xml", "-w", "there", "--domain", "42").code == 0
    outcome = keymint("why", "/cell/arm", "ros_subscribe", "/estop", "-w", "there", "-i", "omg", "--json")
    assert outcome.code == 0, outcome.out
    result = json.loads(outcome.out)["result"]
    assert result["edge"]["domain"] == 42
    assert [each["allowed"] for each in result["transports"]] == [True]
    outcome = keymint("why", "/cell/arm", "ros_subscribe", "/estop", "-w", "there", "-i", "omg", "--domain", "0")
    assert outcome.code == 3
    assert "/cell/arm is granted domain 42, not 0: leave out --domain" in outcome.err
    assert "keymint build" not in outcome.err, "a new build would change nothing"
