# SPDX-License-Identifier: Apache-2.0
"""The published figures of White et al. 2018, from the command line, on simulated transports."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from pathlib import Path

import pytest

from keymint.api.graph import complete
from keymint.api.graph_json import load
from tests.conftest import CHECKOUT

EXAMPLE = CHECKOUT / "examples" / "ppac_2018"
GRAPH = EXAMPLE / "graph.json"
OWN = ("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters")


@dataclass(frozen=True)
class Figures:
    """A confusion table."""

    true_positive: int
    false_negative: int
    false_positive: int
    true_negative: int


PUBLISHED = Figures(13, 5, 5, 29)
WITHOUT_ERROR = Figures(18, 0, 0, 34)


def verified(keymint, policy: str, distro: str, transports: tuple[str, ...], graph: Path = GRAPH):
    """Provision the policy and verify it; return figures and findings by transport, and the exit code."""
    assert keymint("provision", EXAMPLE / policy, "-w", distro, "--distro", distro).code == 0
    chosen = [word for name in transports for word in ("-i", name)]
    outcome = keymint("verify", "-w", distro, "--graph", graph, *chosen, "--json")
    result = outcome.document["result"]
    assert result["edges"] == 52
    figures = {each["name"]: Figures(**each["confusion"]) for each in result["transports"]}
    findings = {
        each["name"]: {
            (found["error"], found["edge"]["subject"], found["edge"]["permission"], found["edge"]["object"])
            for found in each["findings"]
        }
        for each in result["transports"]
    }
    return figures, findings, outcome.code


def published_findings() -> set[tuple[str, str, str, str]]:
    """What the paper says is decided wrongly: all of it is about the services of the listener's parameters."""
    return {
        (error, subject, "ros_call", f"/listener/{service}")
        for error, subject in (("false-negative", "/listener"), ("false-positive", "/talker"))
        for service in OWN
    }


def test_the_graph_and_its_completion() -> None:
    graph = load(GRAPH.read_bytes(), "graph.json")
    assert graph.subjects == ("/listener", "/talker")
    kinds = [found.kind for _, found in graph.objects]
    assert (kinds.count("ros_topic"), kinds.count("ros_service"), len(kinds)) == (3, 10, 13)
    assert (len(graph.edges), len(list(complete(graph)))) == (18, 52)


def test_the_graph_is_that_of_the_papers_discovery_data(keymint, reference: Path, tmp_path: Path) -> None:
    capture = reference / "ppac" / "talker_listener_discovery_data.xml"
    assert keymint("discover", "--no-fold", "--from", capture, "-o", "found.json").code == 0
    found, ours = load((tmp_path / "found.json").read_bytes(), "found.json"), load(GRAPH.read_bytes(), "graph.json")
    assert (found.subjects, found.edges) == (ours.subjects, ours.edges)


def test_the_policy_decides_as_the_papers_policy_does(reference: Path) -> None:
    import comarmor

    theirs, ours = comarmor.load(reference / "ppac" / "comarmor.d"), comarmor.load(EXAMPLE / "policy.xml")
    for edge in complete(load(GRAPH.read_bytes(), "graph.json")):
        asked = (edge.subject, edge.object.kind, edge.permission, edge.object.name)
        assert theirs.decide(*asked).allowed is ours.decide(*asked).allowed, asked


def test_ardent_and_the_papers_amendment(keymint) -> None:
    transports = ("ardent-omg", "ardent-cyclonedds-0.10")
    figures, findings, code = verified(keymint, "amended.xml", "ardent", transports)
    assert figures == dict.fromkeys(transports, PUBLISHED)
    assert findings == dict.fromkeys(transports, published_findings())
    assert code == 3


def test_without_the_amendment_the_middleware_of_ardent_denies_every_service(keymint) -> None:
    figures, findings, _ = verified(keymint, "policy.xml", "ardent", ("ardent-omg",))
    assert figures["ardent-omg"] == Figures(8, 10, 0, 34)
    assert {found[:3] for found in findings["ardent-omg"]} == {
        ("false-negative", "/listener", "ros_call"),
        ("false-negative", "/talker", "ros_call"),
    }


@pytest.mark.parametrize("policy", ["policy.xml", "amended.xml"])
def test_endpoints_that_are_created_where_they_belong_are_decided_as_the_policy_says(keymint, policy: str) -> None:
    transports = ("omg", "cyclonedds-0.10", "fastdds-2.9")
    figures, _, code = verified(keymint, policy, "ardent", transports)
    assert figures == dict.fromkeys(transports, WITHOUT_ERROR)
    assert code == 0


@pytest.mark.parametrize("distro", ["bouncy", "jazzy"])
def test_bouncy_and_later_without_amendment(keymint, distro: str) -> None:
    transports = ("omg", "cyclonedds-0.10", "fastdds-2.9", "ardent-omg")
    figures, _, code = verified(keymint, "policy.xml", distro, transports)
    assert figures == dict.fromkeys(transports, WITHOUT_ERROR)
    assert code == 0


def test_the_figures_that_readme_tells() -> None:
    text = (EXAMPLE / "README.md").read_text()
    for figures in (PUBLISHED, WITHOUT_ERROR):
        assert "| " + " | ".join(map(str, astuple(figures))) + " |" in text
