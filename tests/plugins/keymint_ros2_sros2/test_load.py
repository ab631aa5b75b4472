# SPDX-License-Identifier: Apache-2.0
"""SROS2 policies answer the questions that verbs ask of a policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from keymint_ros2_sros2 import policy_type

from comarmor.errors import ComArmorError, Origin
from keymint.api import LoadedPolicy, PolicySource
from keymint.api.graph import Edge, Object
from tests.effort import calls_of

from .sros2_policies import enclave, policy


def load(*paths: Path) -> LoadedPolicy:
    return policy_type.load([PolicySource("p", path, Origin("profile.xml")) for path in paths], None)


def asked(loaded: LoadedPolicy, permission: str, name: str, kind: str = "ros_topic") -> bool:
    return loaded.decide(Edge("/robot/listener", permission, Object(kind, name))).allowed


def test_decisions(robot: Path) -> None:
    loaded = load(robot)
    assert loaded.subjects() == ("/robot/listener", "/robot/talker")
    assert asked(loaded, "ros_subscribe", "/robot/a/b")
    assert not asked(loaded, "ros_publish", "/robot/a")
    assert asked(loaded, "ros_call", "/robot/add", "ros_service")
    assert asked(loaded, "ros_request", "/robot/dock", "ros_action")
    assert not asked(loaded, "ros_operate", "/robot/dock", "ros_action")
    assert asked(loaded, "publish", "ros_discovery_info", "topic")
    decision = loaded.decide(Edge("/robot/listener", "ros_publish", Object("ros_topic", "/robot/a")))
    assert decision.where is not None
    assert Path(decision.where.file) == robot
    assert not loaded.decide(Edge("/other", "ros_publish", Object("ros_topic", "/x"))).allowed


@pytest.mark.parametrize(
    ("tag", "help_"),
    [("topics", 'publish="ALLOW" or subscribe="ALLOW"'), ("services", 'request="ALLOW"'), ("actions", 'call="ALLOW"')],
)
def test_lint_finds_a_list_without_a_qualifier(keymint, tmp_path: Path, tag: str, help_: str) -> None:
    (tmp_path / "p.xml").write_text(policy(enclave("/a", f"<{tag}><{tag[:-1]}>x</{tag[:-1]}></{tag}>")))
    for verb in (("lint",), ("import", "-o", "new.xml")):
        outcome = keymint(*verb, "p.xml", "--json")
        (found,) = (each for each in outcome.document["diagnostics"] if each["code"] == "sros2-no-qualifier")
        assert (found["severity"], found["help"].startswith(f"add {help_}")) == ("warning", True)
    assert keymint("lint", "p.xml").code == 3


def test_what_it_is_made_of(robot: Path) -> None:
    loaded = load(robot)
    assert loaded.rules("/other") is None
    assert loaded.profiles("/other") == ()
    assert [each.name for each in loaded.profiles("/robot/talker")] == ["/robot/talker"]
    structure = loaded.structure()
    assert [each.name for each in structure.profiles] == ["/robot/talker", "/robot/listener"]
    assert [clause.expand("/", "x") for clause in structure.clauses][-1] == ("ros_discovery_info",)
    assert any(clause.included for clause in structure.clauses)
    names = ["/robot/x", "/y"]
    assert loaded.allowed("/robot/listener", "ros_topic", "ros_subscribe", names) == bytes([1, 0])


def test_what_sros2_enforces_otherwise_is_refused(write) -> None:
    with pytest.raises(ComArmorError) as caught:
        load(write(policy(enclave("/a", ""), enclave("/a", ""))))
    assert caught.value.diagnostics[0].code == "sros2-path-twice"


def test_two_policies_with_one_enclave(write, tmp_path: Path) -> None:
    one = write(policy(enclave("/a", "")))
    two = tmp_path / "two.xml"
    two.write_text(one.read_text())
    with pytest.raises(ComArmorError, match="is also at"):
        load(one, two)


def test_the_fingerprint_changes_with_the_file(robot: Path) -> None:
    loaded = load(robot)
    for path, before in loaded.seen.items():
        assert policy_type.fingerprint(path) == before != b""
        path.write_text("")
        assert policy_type.fingerprint(path) != before
    assert policy_type.fingerprint(robot.parent / "none") == b""


def test_recognised_by_its_root(robot: Path, write) -> None:
    assert policy_type.recognises(robot)
    assert not policy_type.recognises(robot.parent / "none.xml")
    assert not policy_type.recognises(robot.parent)
    assert not policy_type.recognises(robot.parent / "common/node.xml")
    assert not policy_type.recognises(write("<profiles/>"))
    assert not policy_type.recognises(write("no XML"))
    assert policy_type.recognises(write('<policy version="9"/>'))
    loop = robot.with_name("loop.xml")
    loop.symlink_to(loop)
    assert not policy_type.recognises(loop)


def test_the_calls_for_an_enclave(write: Callable[..., Path]) -> None:
    """Most of the work was to look at each character of each name, twice."""
    names = "".join(f"<topic>a_topic_with_a_name_of_some_length_{number}</topic>" for number in range(10))
    rules = f'<topics publish="ALLOW">{names}</topics>'
    path = write(policy(*(enclave(f"/a{number}", rules) for number in range(100))))
    _, calls = calls_of(lambda: load(path))
    assert calls < 100 * 10 * 120


def test_a_policy_is_recognised_by_its_begin_alone(write) -> None:
    assert policy_type.recognises(write('<policy version="9"><a></b>'))
    assert policy_type.recognises(write("<policy><enclaves>"))
    assert not policy_type.recognises(write("<policy><profiles>"))
