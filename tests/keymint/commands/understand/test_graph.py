# SPDX-License-Identifier: Apache-2.0
"""``keymint graph``."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from keymint import __version__
from keymint.api import graph_json
from keymint.api.graph import Edge, Graph, Object
from tests.conftest import NOW, snapshot
from tests.effort import tries
from tests.generated import pretty, tokens

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


@pytest.mark.parametrize("transport", ["dds", "zenoh"])
def test_rights_that_no_transport_of_the_workspace_has_are_not_drawn(keymint, policy: Path, transport: str) -> None:
    """common/node.xml allows a raw topic of DDS."""
    assert keymint("provision", policy, "-w", "ws", "--transport", transport, "--no-prove").code == 0
    drawn = keymint("graph", "--common", "--format", "dot", "-w", "ws").out
    assert ("ros_discovery_info" in drawn) == (transport == "dds")
    assert "/rosout" in drawn


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
    folded = keymint("graph", *arguments, "--format", "svg").out
    drawn = keymint("graph", *arguments, "--format", "svg", "--common").out
    assert folded.count('class="edge') == 2
    assert "common</text>" in folded
    assert "rosout" in drawn
    assert "common</text>" not in drawn
    assert drawn.count('class="edge') > 10


def test_a_rule_of_ones_own_in_a_file_beside_the_library_is_drawn(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    outcome = keymint("graph", "-w", "ws", "--format", "svg")
    assert outcome.code == 0, outcome.err
    assert "/chatter</text>" in outcome.out
    assert "/rosout</text>" not in outcome.out


def test_the_title_is_the_name_of_the_policy_and_not_its_path(keymint, tmp_path: Path) -> None:
    folder = tmp_path / "deep/in/here"
    folder.mkdir(parents=True)
    (folder / "fleet.xml").write_text("<profiles><profile name='a'><attachment>/a</attachment></profile></profiles>")
    for path in (folder / "fleet.xml", folder):
        found = keymint("graph", path, "--format", "svg").out
        assert f"<title>{path.stem}</title>" in found
        assert str(tmp_path) not in found


def test_a_copy_of_the_library_that_was_edited_hides_nothing(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    copy = tmp_path / "ws/profile/comarmor.d/common/node/logging.xml"
    copy.write_text(copy.read_text().replace("/rosout", "/cmd_vel"))
    outcome = keymint("graph", "-w", "ws", "--format", "svg")
    assert outcome.code == 0, outcome.err
    assert "/cmd_vel</text>" in outcome.out
    assert "/rosout</text>" not in outcome.out


def fleet_policy(count: int, *, alike: bool) -> str:
    """Return a policy of robots; those that are not alike each read what the next one publishes."""
    profiles = []
    for at in range(count):
        other = at if alike else (at + 1) % count
        rules = (("ros_publish", f"/r{at}/image"), ("ros_subscribe", f"/r{other}/image"), ("ros_publish", "/state"))
        profiles.append(
            f"<profile name='p{at}'><attachment>/r{at}/cam</attachment>"
            + "".join(
                f"<ros_topic qualifier='ALLOW'><attachment>{topic}</attachment>"
                f"<permissions><{permission}/></permissions></ros_topic>"
                for permission, topic in rules
            )
            + "</profile>"
        )
    return f"<profiles>{''.join(profiles)}</profiles>"


@pytest.mark.parametrize("kind", ["svg", "dot", "html"])
@pytest.mark.parametrize("alike", [True, False])
def test_300_subjects_with_every_right(keymint, tmp_path: Path, kind: str, alike: bool) -> None:
    (tmp_path / "policy.xml").write_text(fleet_policy(300, alike=alike))
    outcome = keymint("graph", "policy.xml", "-f", kind, "--json")
    assert outcome.code == 0, outcome.out
    result = outcome.document["result"]
    assert (result["edges"], result["left_out"]) == ({"allow": 900}, [])
    assert result["drawn"] + result["folded"] == 900
    if alike and kind != "html":
        (found,) = result["alike"]
        assert (found["like"], len(found["names"]), result["drawn"]) == ("/r0", 300, 3)
        assert "300 robots like /r0 (/r0, /r1, /r2, /r3, /r4, …)" in result["content"]


def test_what_is_not_drawn_is_a_finding_unless_a_limit_was_asked(keymint, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(fleet_policy(300, alike=False))
    arguments = ("graph", "policy.xml", "--no-group", "--no-fold", "--json")
    outcome = keymint(*arguments)
    left_out = [{"outcome": "allow", "kind": "ros_topic", "edges": 300}]
    assert (outcome.code, outcome.document["result"]["left_out"]) == (3, left_out)
    assert [each["code"] for each in outcome.document["diagnostics"]] == ["picture-incomplete"]
    assert outcome.document["result"]["drawn"] == 600
    assert "NOT DRAWN: 300 of 900 edges: 300 allowed (300 topic)" in outcome.document["result"]["content"]
    assert "300 edges not drawn: 300 allowed (300 topic)" in keymint(*arguments[:-1], "-o", "p.svg").err
    limited = keymint(*arguments, "--limit", "100")
    assert (limited.code, limited.document["result"]["left_out"][0]["edges"]) == (0, 800)
    assert "NOT DRAWN: 800 of 900 edges" in limited.document["result"]["content"]


def test_a_picture_says_when_and_of_what_it_was_made(keymint, provisioned: Path, policy: Path, captured: Path) -> None:
    def digest(*lines: str) -> str:
        return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()

    alone = policy.with_name("alone.xml")
    alone.write_text(fleet_policy(2, alike=True))
    of_file = f"policy sha256 {digest(hashlib.sha256(alone.read_bytes()).hexdigest())}"
    for kind in ("svg", "dot", "html"):
        found = keymint("graph", alone, "-f", kind).out
        assert f"keymint {__version__}, 2027-01-15" in found
        assert of_file in found
        assert keymint("graph", alone, "-f", kind, env={"SOURCE_DATE_EPOCH": str(NOW + 86_400)}).out == found.replace(
            "2027-01-15", "2027-01-16"
        )
    install = provisioned / "install"
    names = sorted(str(path.relative_to(install)) for path in install.rglob("*") if path.is_file())
    kept = [name for name in names if not name.endswith("key.pem")]
    assert len(kept) < len(names)
    files = (f"{hashlib.sha256((install / name).read_bytes()).hexdigest()}  {name}" for name in kept)
    assert f"keystore sha256 {digest(*files)}" in keymint("graph", cwd=provisioned).out
    of_graph = f"graph sha256 {hashlib.sha256(captured.read_bytes()).hexdigest()}"
    labelled = keymint("graph", captured, "--policy", alone, "--format", "svg").out
    assert of_graph in labelled
    assert of_file in labelled


def test_rights_of_subjects_without_a_name_are_not_hidden(keymint, tmp_path: Path) -> None:
    rule = (
        "<ros_topic qualifier='ALLOW'><attachment>/t</attachment><permissions><ros_publish/></permissions></ros_topic>"
    )
    (tmp_path / "policy.xml").write_text(
        f"<profiles><profile name='a'><attachment>/a</attachment>{rule}</profile>"
        f"<profile name='b'><attachment>/cell*/arm</attachment><attachment>/b</attachment>{rule}</profile></profiles>"
    )
    said = "not drawn: rights of other subjects like /cell*/arm (--subject NAME draws one)"
    for kind in ("svg", "dot", "html"):
        result = keymint("graph", "policy.xml", "-f", kind, "--json").document["result"]
        assert (result["subjects"], result["unnamed"]) == (["/a", "/b"], ["/cell*/arm"])
        words = " ".join(re.sub(r"<[^>]*>", " ", result["content"]).split())  # a caption has lines
        assert said in words
    chosen = keymint("graph", "policy.xml", "--subject", "/cell7/arm", "--json").document["result"]
    assert (chosen["edges"], chosen["unnamed"]) == ({"allow": 1}, [])


@given(seed=st.integers(0, 10**6), limit=st.sampled_from([[], ["--limit", "3"], ["--group"], ["--fold", "--all"]]))
@settings(max_examples=tries(20, 100), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_rights_of_random_policies_are_drawn_or_folded_or_counted(
    keymint, tmp_path: Path, seed: int, limit: list[str]
) -> None:
    (tmp_path / "random.xml").write_text(pretty(tokens(seed)))
    subjects = [f"--subject={robot}/{node}" for robot in ("/r1", "/r2", "/fleet/r1") for node in ("talker", "camera")]
    found = [
        outcome.document["result"]
        for arguments in ([], *([each] for each in subjects))
        if (outcome := keymint("graph", "random.xml", *arguments, *limit, "--json")).code in {0, 3}
    ]
    for result in found:
        left_out = sum(each["edges"] for each in result["left_out"])
        assert result["drawn"] + result["folded"] + left_out == sum(result["edges"].values())
        lines = result["content"].count('<g class="edge ')
        assert lines == result["drawn"]
        assert (f"NOT DRAWN: {left_out} of " in result["content"]) == (left_out > 0)
