# SPDX-License-Identifier: Apache-2.0
"""An endpoint that a transport allows is a mismatch of its own if the policy denies all that needs it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from keymint_ros2_comarmor import policy_type
from keymint_ros2_dds import build_type

from comarmor.errors import Origin
from keymint.api import Availability, InstalledEnclave, PolicySource, Tier, Verdict
from keymint.api.graph import Column, ConfusionMatrix, Edge, EdgeOutcome, Object
from keymint.verify.compare import Asking, EdgeComparison, Mismatch, TransportComparison
from keymint.verify.endpoint_policy import EdgeRow, EndpointPolicy, Naming

HERE = Origin("permissions.p7s", 1)
RULES = """<ros_service qualifier="ALLOW"><attachment>/allowed</attachment>
  <permissions><ros_call/></permissions></ros_service>"""


@dataclass(frozen=True)
class Transport:
    """Allows the endpoints with these names."""

    allowed: frozenset[str]

    def usable(self) -> Availability:
        return Availability(True, tiers=(Tier.DECISION,))

    def label(
        self,
        enclaves: Sequence[InstalledEnclave],  # noqa: ARG002
        edges: Iterable[Edge],
        tier: Tier,  # noqa: ARG002
    ) -> Iterator[tuple[Edge, Verdict]]:
        for edge in edges:
            yield edge, Verdict(edge.object.name in self.allowed)


@pytest.fixture
def judge(tmp_path: Path) -> EndpointPolicy:
    path = tmp_path / "policy.xml"
    path.write_text(f"<profiles><profile name='s'><attachment>/s</attachment>{RULES}</profile></profiles>")
    policy = policy_type.load([PolicySource("policy", path, Origin("test"))], None)
    return EndpointPolicy(policy, {"/s": Naming(build_type.names, "humble")})


def call(name: str) -> Edge:
    return Edge("/s", "ros_call", Object("ros_service", name))


def compared(judge: EndpointPolicy, allowed: set[str], edges: Sequence[Edge], limit: int = 10) -> EdgeComparison:
    """Add the endpoints to a comparison without mismatches."""

    def explain(name: str, enclave: InstalledEnclave, wrong: list[tuple[Edge, Verdict]]) -> list[Mismatch]:
        return [Mismatch(edge, judge.decide(edge), verdict, verdict.reason, HERE) for edge, verdict in wrong]

    asking = Asking(Tier.DECISION, limit, lambda _name, _subject: None)
    enclaves = {"/s": InstalledEnclave("/s", Path("/nowhere/s"), "humble", Path("/nowhere"))}
    comparison = TransportComparison("fake", Transport(frozenset(allowed)), enclaves, explain, asking)
    comparison.halves([EdgeRow("/s", Column(tuple(edges)))], bytes(judge.decide(edge).allowed for edge in edges), judge)
    return comparison.result()


def names(comparison: EdgeComparison) -> list[str]:
    return [mismatch.edge.object.name for mismatch in comparison.findings]


def test_one_endpoint_of_a_denied_service_is_a_false_positive(judge: EndpointPolicy) -> None:
    comparison = compared(judge, {"rq/deniedRequest"}, [call("/denied"), call("/other")])
    assert names(comparison) == ["rq/deniedRequest"]
    assert comparison.findings[0].error is EdgeOutcome.FALSE_POSITIVE
    assert comparison.confusion == ConfusionMatrix(false_positive=1)
    assert comparison.wrong == {"/s": 1}


def test_endpoints_of_a_service_that_is_allowed_completely_are_no_halves(judge: EndpointPolicy) -> None:
    both = {"rq/deniedRequest", "rr/deniedReply"}
    assert names(compared(judge, both, [call("/denied")])) == []
    assert names(compared(judge, {"rq/allowedRequest"}, [call("/allowed")])) == []


def test_an_endpoint_that_is_an_edge_itself_is_omitted(judge: EndpointPolicy) -> None:
    itself = Edge("/s", "publish", Object("topic", "rq/deniedRequest"))
    assert names(compared(judge, {"rq/deniedRequest"}, [itself, call("/denied")])) == []


def test_all_endpoints_are_counted_and_the_first_are_kept(judge: EndpointPolicy) -> None:
    services = [f"denied{number}" for number in range(5)]
    comparison = compared(judge, {f"rr/{name}Reply" for name in services}, [call(f"/{name}") for name in services], 2)
    assert len(comparison.findings) == 2
    assert (comparison.confusion.false_positive, comparison.omitted, comparison.wrong) == (5, 3, {"/s": 5})
