# SPDX-License-Identifier: Apache-2.0
"""``keymint lint``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from keymint.api import plugin_loader
from keymint.run import run
from tests.conftest import CHECKOUT
from tests.keymint import lighthouse
from tests.keymint.plain_build_type import PlainBuildType

BAD = """<profiles><profile name="a"><attachment>/a</attachment>
<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
<ros_topic qualifier="DENY"><attachment>/y</attachment><permissions><ros_publish/></permissions></ros_topic>
<ros_topic qualifier="ALLOW"><attachment>/z</attachment><permissions><ros_relay/></permissions></ros_topic>
</profile></profiles>"""


@pytest.mark.parametrize("name", ["fleet", "action", "operator", "talker_listener"])
def test_the_examples_have_no_finding(keymint, name: str) -> None:
    outcome = keymint("lint", CHECKOUT / "examples" / name, "--json")
    assert (outcome.code, outcome.codes()) == (0, [])


def test_an_example_reads_parameters_and_sets_none_on_purpose(keymint) -> None:
    """Its README says with what kind of client that works."""
    outcome = keymint("lint", CHECKOUT / "examples/add_two_ints", "--json")
    assert (outcome.code, outcome.codes()) == (0, ["parameter-client-cannot-start"])


TWO_ROBOTS = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
<tunable name="R"><value>/r1</value><value>/r2</value><value>/r3</value><value>/r4</value></tunable>
<profile name="arm"><attachment>@{R}/arm</attachment>
<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic></profile>
<profile name="leg"><attachment>/leg</attachment><xi:include href="common/node.xml" parse="xml"/>
<ros_parameter qualifier="ALLOW"><attachment>/r1/arm</attachment><permissions><ros_read/></permissions></ros_parameter>
</profile>
</profiles>"""


def test_what_cannot_start_is_a_note_for_each_profile(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(TWO_ROBOTS)
    outcome = keymint("lint", "p.xml", "--sarif", "out.sarif")
    assert outcome.code == 0
    assert outcome.out.startswith("no findings in the rules of 5 subjects")
    arms, leg = outcome.err.splitlines()
    assert arms.startswith("p.xml:3: note: /r1/arm, /r2/arm, /r3/arm, …: a node of this subject cannot start on Jazzy")
    assert leg.startswith("p.xml:6: note: /leg: a client of parameters")
    assert keymint("lint", "p.xml", "-q").err == ""
    run = json.loads((tmp_path / "out.sarif").read_text())["runs"][0]
    noted = [(each["ruleId"], each["level"]) for each in run["results"]]
    assert noted == [("node-cannot-start", "note"), ("parameter-client-cannot-start", "note")]
    assert "get_type_description" not in keymint("lint", "p.xml", "--distro", "humble").err
    assert keymint("lint", "p.xml", "--distro", "eloquent").err == ""
    assert keymint("lint", "p.xml", "--build-type", "keymint_ros2_zenoh").err.count("cannot start") == 0


def test_check_notes_it_too_and_is_content(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(TWO_ROBOTS)
    assert keymint("provision", "p.xml", "-w", "ws").code == 0
    outcome = keymint("check", "-w", "ws", "--strict")
    assert (outcome.code, outcome.out.startswith("checked 5 enclaves: no findings")) == (0, True)
    assert [line.split(": a ")[0] for line in outcome.err.splitlines()] == [
        "p.xml:6: note: /leg",
        "p.xml:3: note: /r1/arm, /r2/arm, /r3/arm, …",
    ]
    one = keymint("check", "leg", "-w", "ws", "--json")
    assert [each["subject"] for each in one.document["diagnostics"] if "start" in each["code"]] == ["/leg"]


def test_findings(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(BAD)
    outcome = keymint("lint", "p.xml", "--json", "--sarif", "out.sarif")
    assert outcome.code == 3
    listed = [(each["code"], each["file"], each["line"]) for each in outcome.document["diagnostics"]]
    assert listed[0] == ("node-cannot-start", "p.xml", 1)
    assert listed[1:] == [("deny-nothing", "p.xml", 3), ("portability-relay", "p.xml", 4)]
    assert outcome.document["result"]["findings"] == 2
    run = json.loads((tmp_path / "out.sarif").read_text())["runs"][0]
    rules = [each["id"] for each in run["tool"]["driver"]["rules"]]
    for result in run["results"]:
        assert rules[result["ruleIndex"]] == result["ruleId"]
    place = run["results"][1]["locations"][0]["physicalLocation"]
    assert place == {"artifactLocation": {"uri": "p.xml"}, "region": {"startLine": 3, "startColumn": 1}}


def test_what_the_compiler_refuses(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(BAD.replace("/y", "/[!x]"))
    codes = keymint("lint", "p.xml", "--json").codes()
    assert any(code.startswith("portability") for code in codes)


def test_the_policy_of_a_workspace(keymint, provisioned: Path) -> None:
    assert keymint("lint", cwd=provisioned).code == 0
    assert keymint("lint", provisioned).code == 0


@pytest.mark.parametrize(("path", "said"), [("nothing.xml", "does not exist"), ("p.xml", "p.xml:1")])
def test_mistakes(keymint, tmp_path: Path, path: str, said: str) -> None:
    (tmp_path / "p.xml").write_text("<profiles>")
    outcome = keymint("lint", path)
    assert (outcome.code, outcome.out) == (1, "")
    assert said in outcome.err


def test_rules_of_subjects_that_nobody_names(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(BAD.replace("<attachment>/a<", "<attachment>/a/*<"))
    outcome = keymint("lint", "p.xml", "--json")
    assert outcome.codes() == ["deny-nothing", "portability-relay"]
    assert keymint("lint", "p.xml").out == "2 findings in the rules of no subjects and 1 pattern of subjects\n"


def test_a_name_that_nothing_has_is_said_once(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(BAD.replace("<attachment>/x<", "\n<attachment>/x</attachment>\n<attachment>w<"))
    outcome = keymint("lint", "p.xml", "--json")
    assert [each["line"] for each in outcome.document["diagnostics"] if each["code"] == "object-never"] == [4]
    assert "never-matches" not in outcome.codes()


@pytest.fixture
def lit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second transport is installed, which carries topics only."""
    monkeypatch.setattr(run, "entries_in", lambda metadata: (*plugin_loader.entries_in(metadata), *lighthouse.ENTRIES))


@pytest.mark.usefixtures("lit")
def test_all_transports_of_the_workspace_are_asked(keymint, tmp_path: Path) -> None:
    policy = BAD.replace("ros_topic", "ros_service").replace("publish", "call").replace("relay", "execute")
    (tmp_path / "p.xml").write_text(policy)
    found = {}
    for name in ("dds", "light"):
        assert keymint("init", name, "--policy", "p.xml", "--transport", name).code == 0
        found[name] = keymint("lint", name, "--json").codes()
    light = ["light-kind", "deny-nothing", "light-kind", "light-kind"]
    assert found == {"dds": ["node-cannot-start", "deny-nothing"], "light": light}
    both = ("--build-type", "keymint_ros2_dds", "--build-type", lighthouse.NAME)
    assert sorted(keymint("lint", "p.xml", *both, "--json").codes()) == sorted([*light, "node-cannot-start"])
    assert keymint("lint", "p.xml", "--json").codes() == found["dds"]


@pytest.mark.usefixtures("lit")
def test_a_build_type_that_checks_no_rules(keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "p.xml").write_text(BAD)
    assert keymint("init", "ws", "--policy", "p.xml", "--transport", "light").code == 0
    kept = {name: value for name, value in vars(lighthouse.LighthouseBuildType).items() if name != "check_rules"}
    monkeypatch.setattr(lighthouse, "build_type", type("Dark", (PlainBuildType,), kept)())
    assert keymint("lint", "ws", "--json").codes() == ["deny-nothing"]
    outcome = keymint("lint", "p.xml", "--build-type", lighthouse.NAME)
    assert outcome.code == 2
    assert f"the build type {lighthouse.NAME} checks no rules" in outcome.err
