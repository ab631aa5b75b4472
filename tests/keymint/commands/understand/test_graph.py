# SPDX-License-Identifier: Apache-2.0
"""``keymint graph``."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.api import graph_json
from keymint.api.graph import Edge, Graph, Object
from tests.conftest import snapshot

TOPIC = Object("ros_topic", "/chatter")


@pytest.fixture
def captured(tmp_path: Path) -> Path:
    """A graph of which the policy denies one edge."""
    edges = [Edge("/talker", "ros_publish", TOPIC), Edge("/talker", "ros_subscribe", TOPIC)]
    path = tmp_path / "graph.json"
    path.write_bytes(graph_json.dump(Graph.of(edges)))
    return path


@pytest.mark.parametrize(
    ("suffix", "start"),
    [("svg", b"<?xml"), ("png", b"\x89PNG"), ("dot", b"digraph"), ("gv", b"digraph"), ("html", b"<!DOCTYPE html>")],
)
def test_every_format(keymint, policy: Path, tmp_path: Path, suffix: str, start: bytes) -> None:
    outcome = keymint("graph", policy, "-o", f"out.{suffix}")
    assert outcome.code == 0, outcome.err
    assert (tmp_path / f"out.{suffix}").read_bytes().startswith(start)
    assert outcome.out == f"out.{suffix} written\n"
    assert keymint("graph", policy, "-o", f"out.{suffix}").out == f"out.{suffix} is up to date\n"


def test_standard_output(keymint, policy: Path) -> None:
    assert keymint("graph", policy).out.startswith("<?xml")
    assert keymint("graph", policy, "--format", "dot").out.startswith("digraph")
    assert "end it" not in keymint("graph", policy, "--format", "png").err
    assert keymint("graph", policy, "--format", "png").code == 2


def test_the_policy_of_the_workspace(keymint, provisioned: Path) -> None:
    before = snapshot(provisioned)
    outcome = keymint("graph", "--json", cwd=provisioned)
    assert outcome.document["result"]["subjects"] == ["/robot1/listener", "/talker"]
    assert outcome.document["result"]["edges"]["allow"] > 2
    assert snapshot(provisioned) == before


def test_the_report_has_the_policy(keymint, policy: Path, tmp_path: Path) -> None:
    keymint("graph", policy.name, "-o", "out.html")
    text = (tmp_path / "out.html").read_text()
    assert ">policy.xml</h3>" in text
    assert '<a href="#f' in text
    assert str(tmp_path) not in text


def test_a_graph(keymint, captured: Path) -> None:
    assert keymint("graph", captured, "--json").document["result"]["edges"] == {"unlabelled": 2}


def test_a_graph_by_a_policy(keymint, captured: Path, policy: Path) -> None:
    def edges(*options: object) -> dict[str, int]:
        outcome = keymint("graph", captured, "--policy", policy, "--json", *options)
        assert outcome.code == 0, outcome.out
        return outcome.document["result"]["edges"]

    assert edges() == {"allow": 1, "deny": 1}
    assert edges("--all") == {"allow": 1, "deny": 1}
    assert edges("--only", "denied") == {"deny": 1}


def test_a_capture(keymint, reference: Path) -> None:
    outcome = keymint("graph", reference / "ppac/talker_listener_discovery_data.xml", "--json")
    assert outcome.document["result"]["subjects"] == ["/listener", "/talker"]


def test_some_subjects(keymint, policy: Path) -> None:
    by_name = keymint("graph", policy, "--subject", "/talker", "--json").document["result"]
    by_namespace = keymint("graph", policy, "--namespace", "/robot1", "--json").document["result"]
    assert by_name["subjects"] == ["/talker"]
    assert by_namespace["subjects"] == ["/robot1/listener"]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["policy.xml", "-o", "out.jpg"], 2, "has an unknown suffix"),
        (["policy.xml", "--policy", "policy.xml"], 2, "--policy labels only graphs"),
        (["graph.json", "--all"], 2, "--policy PATH"),
        (["graph.json", "--subject", "/taker"], 2, "did you mean '/talker'?"),
        (["policy.xml", "--namespace", "/robot"], 2, "did you mean '/robot1/'?"),
        (["nothing.xml"], 1, "no such file"),
    ],
)
def test_mistakes(keymint, policy: Path, captured: Path, arguments: list[str], code: int, said: str) -> None:
    outcome = keymint("graph", *arguments)
    assert (outcome.code, outcome.out) == (code, "")
    assert said in outcome.err


def test_a_defect_has_its_place(keymint, policy: Path) -> None:
    policy.write_text("<profiles>")
    assert "policy.xml:1" in keymint("graph", policy).err


def test_dry_run(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("graph", policy, "-o", "out.svg", "--dry-run").out == "out.svg would be written\n"
    assert not (tmp_path / "out.svg").exists()


@pytest.mark.parametrize("where", ["policy", "workspace"])
def test_common_rules_are_folded_wherever_the_library_lies(
    keymint, provisioned: Path, policy: Path, where: str
) -> None:
    arguments = [policy] if where == "policy" else ["-w", provisioned]
    folded = keymint("graph", *arguments, "-f", "svg").out
    drawn = keymint("graph", *arguments, "-f", "svg", "--common").out
    assert folded.count('class="edge') == 2
    assert "common</text>" in folded
    assert "rosout" in drawn
    assert "common</text>" not in drawn
    assert drawn.count('class="edge') > 10


def test_a_rule_of_ones_own_in_a_file_beside_the_library_is_drawn(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    outcome = keymint("graph", "-w", "ws", "-f", "svg")
    assert outcome.code == 0, outcome.err
    assert "/chatter</text>" in outcome.out
    assert "/rosout</text>" not in outcome.out


def test_the_title_is_the_name_of_the_policy_and_not_its_path(keymint, tmp_path: Path) -> None:
    folder = tmp_path / "deep/in/here"
    folder.mkdir(parents=True)
    (folder / "fleet.xml").write_text("<profiles><profile name='a'><attachment>/a</attachment></profile></profiles>")
    for path in (folder / "fleet.xml", folder):
        found = keymint("graph", path, "-f", "svg").out
        assert f"<title>{path.stem}</title>" in found
        assert str(tmp_path) not in found


def test_a_copy_of_the_library_that_was_edited_hides_nothing(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    copy = tmp_path / "ws/profile/comarmor.d/common/node/logging.xml"
    copy.write_text(copy.read_text().replace("/rosout", "/cmd_vel"))
    outcome = keymint("graph", "-w", "ws", "-f", "svg")
    assert outcome.code == 0, outcome.err
    assert "/cmd_vel</text>" in outcome.out
    assert "/rosout</text>" not in outcome.out
