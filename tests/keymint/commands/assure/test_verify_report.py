# SPDX-License-Identifier: Apache-2.0
"""``keymint verify --report``."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from lxml import html

from comarmor.errors import Origin, Reason
from keymint.api import PolicyDecision, Tier, Verdict
from keymint.api.graph import Column, ConfusionMatrix, Edge, EdgeOutcome, Object
from keymint.commands.assure import verify
from keymint.commands.assure.verify import labelled_edges
from keymint.drawing.html_report import html_report
from keymint.drawing.labelled_graph import Label
from keymint.drawing.svg import svg
from keymint.verify.compare import EdgeComparison, Mismatch
from keymint.verify.endpoint_policy import EdgeRow
from keymint.verify.verification import Verification
from tests.conftest import CHECKOUT

EDGES = [Edge("/a", "ros_publish", Object("ros_topic", f"/t{at}")) for at in range(4)]
DENIED = PolicyDecision(False, None, Reason(("no rule",)))


def finding(edge: Edge) -> Mismatch:
    verdict = Verdict(True, "allowed", deviation="row 5")
    return Mismatch(edge, DENIED, verdict, "allow rule 2", Origin("/ws/permissions.xml", 7), "omg")


def outcome(name: str, counts: ConfusionMatrix, *findings: Mismatch) -> EdgeComparison:
    return EdgeComparison(name, "1", Tier.DECISION, counts, findings, {})


def labels(*outcomes: EdgeComparison):
    row = EdgeRow("/a", Column(tuple(EDGES)))
    verified = Verification("b", ("/a",), lambda: iter([row]), bytearray(4), lambda _edge: DENIED, outcomes)
    return labelled_edges("t", verified, lambda file: file.removeprefix("/ws/"))


def test_edges_without_findings_are_labelled_as_the_policy_does() -> None:
    graph = labels(
        outcome("x", ConfusionMatrix(0, 0, 1, 3), finding(EDGES[1])), outcome("y", ConfusionMatrix(0, 0, 0, 4))
    )
    why = "allow rule 2; row 5"
    assert [one.transports for one in graph.edges] == [
        (Label(False), Label(False)),
        (Label(True, why, Origin("permissions.xml", 7)), Label(False)),
        (Label(False), Label(False)),
        (Label(False), Label(False)),
    ]
    assert [graph.confusion(at) for at in (0, 1)] == [ConfusionMatrix(0, 0, 1, 3), ConfusionMatrix(0, 0, 0, 4)]


def test_nothing_is_said_after_the_last_finding_that_was_kept() -> None:
    graph = labels(outcome("x", ConfusionMatrix(0, 0, 2, 2), finding(EDGES[1])))
    assert [one.transports[0] and one.transports[0].allowed for one in graph.edges] == [False, True, None, None]


def test_no_finding_was_kept() -> None:
    graph = labels(outcome("x", ConfusionMatrix(0, 0, 2, 2)))
    assert [one.transports for one in graph.edges] == [(None,)] * 4


def test_a_finding_on_an_endpoint_follows_the_edges_of_the_graph() -> None:
    endpoint = Edge("/a", "publish", Object("topic", "rq/sRequest"))
    graph = labels(
        outcome("x", ConfusionMatrix(0, 0, 1, 4), finding(endpoint)), outcome("y", ConfusionMatrix(0, 0, 0, 4))
    )
    assert [one.edge for one in graph.edges] == sorted([endpoint, *EDGES])
    (found,) = [one for one in graph.edges if one.edge == endpoint]
    assert [said and said.allowed for said in found.transports] == [True, False]


def test_the_report_of_a_workspace(keymint, provisioned: Path) -> None:
    found = keymint("verify", "-i", "omg", "--report", "report", cwd=provisioned)
    assert found.code == 0, found.err
    folder = provisioned / "report"
    assert {path.name for path in folder.iterdir()} == {"index.html", "graph.svg", "graph-omg.svg", "differences.svg"}
    assert "allowed (true positive)" in (folder / "graph.svg").read_text()
    assert "policy.xml</h3>" in (folder / "index.html").read_text()


def test_a_finding_is_in_the_report(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<ros_subscribe/>", "<ros_publish/>"))
    found = keymint("verify", "-i", "omg", "--report", "report", cwd=provisioned)
    assert found.code == 3
    text = (provisioned / "report/index.html").read_text()
    assert 'class="false-positive"' in text
    assert 'class="false-negative"' in text
    assert "permissions.xml" in text
    assert "false positive" in (provisioned / "report/differences.svg").read_text()


def test_one_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Edges that are not kept count as well, by kind; single topics are no edges."""
    endpoint = Edge("/a", "publish", Object("topic", "rq/sRequest"))
    found = outcome("x", ConfusionMatrix(0, 0, 1, 4), finding(endpoint))
    monkeypatch.setattr(verify, "MOST_TRUE", 1)
    graph = labels(found)
    assert (len(graph.edges), graph.omitted, graph.total, graph.endpoints) == (
        2,
        {(EdgeOutcome.DENY, "ros_topic"): 3},
        5,
        1,
    )
    page = html_report(graph, {}).decode()
    assert "4 edges, 1 single topic</p>" in page
    assert "NOT LISTED: 3 of these edges: 3 denied (3 topic)" in page
    assert "4 edges, 1 single topic; " in svg(graph).decode()
    assert "NOT DRAWN: 3 of 5 edges: 3 denied (3 topic)" in svg(graph).decode()


def test_the_report_has_the_count_of_the_verb_and_marks_probes(keymint, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(POLICY)
    assert keymint("provision", "policy.xml", "-w", "ws").code == 0
    found = keymint("verify", "-t", "omg", "-w", "ws", "--report", "report", "--json")
    assert found.code == 0, found.err
    edges = found.document["result"]["edges"]
    assert found.document["result"]["left_out"] == []
    page = html.document_fromstring((tmp_path / "report/index.html").read_bytes())
    assert f"{edges} edges" in page.xpath("string(//header)")
    assert sum(int(one.text) for one in page.xpath("//ul[@class='counts']//strong")) == edges
    assert len(page.xpath("//section[@class='subject-part']//tr[@data-v]")) == edges
    probes = {
        cell.xpath("string(.//a)"): bool(cell.xpath(".//span[text()='probe']"))
        for cell in page.xpath("//section[@id='objects']//tbody/tr/td[1]")
    }
    real = {"/chatter", "/fibonacci", "/fibonacci/_action/feedback", "/fibonacci/_action/send_goal", "rt/raw"}
    assert {name for name, probe in probes.items() if not probe} >= real
    assert {name for name in probes if "chatterx" in name or name.startswith(("/images", "rt/images"))} <= {
        name for name, probe in probes.items() if probe
    }
    made = page.xpath("//header/p[contains(@class, 'made')]/text()")
    assert [line.split()[0] for line in made] == ["keymint", "policy", "keystore"]
    command = re.findall(r"in `install/`: `(.*)` \|$", (CHECKOUT / "docs/graph.md").read_text(), re.MULTILINE)[0]
    shell = ["sh", "-c", command.replace("\\|", "|")]
    digest = subprocess.run(shell, cwd=tmp_path / "ws/install", capture_output=True, check=True).stdout.decode()
    assert f"keystore sha256 {digest.split()[0]}" == made[2]
    for name in ("graph", "graph-omg", "differences"):
        text = (tmp_path / f"report/{name}.svg").read_text()
        assert all(line in text for line in made)
    assert "name made up to probe a pattern" in (tmp_path / "report/graph.svg").read_text()


POLICY = """<profiles><profile name='a'><attachment>/a</attachment>
<ros_topic qualifier='ALLOW'><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
<ros_topic qualifier='ALLOW'><attachment>/images/*</attachment><permissions><ros_subscribe/></permissions></ros_topic>
<ros_action qualifier='ALLOW'><attachment>/fibonacci</attachment><permissions><ros_operate/></permissions></ros_action>
<topic qualifier='ALLOW'><attachment>rt/raw</attachment><permissions><publish/></permissions></topic>
</profile></profiles>"""
