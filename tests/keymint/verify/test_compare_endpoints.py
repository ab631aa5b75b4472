# SPDX-License-Identifier: Apache-2.0
"""To ask for all endpoints of a subject at once gives the same comparison as to ask edge by edge, halves included."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_comarmor import policy_type
from keymint_ros2_dds import build_type

from comarmor.errors import Origin, Reason
from keymint.api import Availability, InstalledEnclave, PolicyDecision, PolicySource, Tier, Verdict
from keymint.api.graph import Column, Edge, Object
from keymint.errors import KeymintError
from keymint.verify.compare import ENCLAVE_REFUSED, Asking, EdgeComparison, Mismatch, TransportComparison
from keymint.verify.endpoint_policy import EdgeRow, EndpointPolicy, Naming, label

SUBJECTS = ("/a", "/b", "/c")
ENCLAVES = {name: InstalledEnclave(name, Path("/nowhere") / name[1:], "humble", Path("/nowhere")) for name in SUBJECTS}
NAMING = Naming(build_type.names, "humble")
REQUESTS = (
    *(Edge("", "ros_publish", Object("ros_topic", name)) for name in ("/x", "/y")),
    *(Edge("", permission, Object("ros_service", "/s")) for permission in ("ros_call", "ros_execute")),
    Edge("", "ros_call", Object("ros_service", "/t")),
    Edge("", "ros_request", Object("ros_action", "/move")),
    Edge("", "publish", Object("topic", "rq/sRequest")),
    Edge("", "publish", Object("topic", "rt/x", ("p",))),
    Edge("", "publish", Object("topic", "rt/x"), 1),
)
ENDPOINTS = sorted({endpoint for request in REQUESTS for endpoint in NAMING.endpoints(request)})
RULES = """<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
<ros_service qualifier="ALLOW"><attachment>/s</attachment><permissions><ros_call/></permissions></ros_service>
<topic qualifier="DENY"><attachment>rr/s*</attachment><permissions><publish/></permissions></topic>
<topic qualifier="ALLOW"><attachment>rq/tRequest</attachment><permissions><publish/></permissions></topic>"""


@dataclass
class Transport:
    """Admits some endpoints of each subject, and refuses one enclave."""

    endpoints: frozenset[tuple[str, Edge]]
    refuses: str = ""
    asked: list[Edge] = field(default_factory=list)

    def usable(self) -> Availability:
        return Availability(True, "9", tiers=(Tier.DECISION,))

    def _admits(self, subject: str, endpoint: Edge) -> bool:
        if subject == self.refuses:
            raise KeymintError("the grant is for another", code=ENCLAVE_REFUSED)
        return (subject, Edge("", endpoint.permission, endpoint.object, endpoint.domain)) in self.endpoints

    def label(
        self,
        enclaves: Sequence[InstalledEnclave],  # noqa: ARG002
        edges: Iterable[Edge],
        tier: Tier,  # noqa: ARG002
    ) -> Iterator[tuple[Edge, Verdict]]:
        for edge in edges:
            self.asked.append(edge)
            allowed = all(self._admits(edge.subject, endpoint) for endpoint in NAMING.endpoints(edge))
            yield edge, Verdict(allowed, f"decided for {edge.subject}")

    def admitted(self, enclave: InstalledEnclave, endpoints: Column, tier: Tier) -> bytes:  # noqa: ARG002
        return bytes(self._admits(enclave.subject, each) for each in endpoints.requests)


def explain(name: str, enclave: InstalledEnclave, wrong: list[tuple[Edge, Verdict]]) -> list[Mismatch]:
    decided = PolicyDecision(False, None, Reason(("",)))
    return [Mismatch(edge, decided, verdict, f"{name} {enclave.subject}", Origin("x")) for edge, verdict in wrong]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> EndpointPolicy:
    path = tmp_path_factory.mktemp("policy") / "policy.xml"
    path.write_text(f"<profiles><profile name='s'><attachment>/[ab]</attachment>{RULES}</profile></profiles>")
    policy = policy_type.load([PolicySource("policy", path, Origin("test"))], None)
    return EndpointPolicy(policy, dict.fromkeys(SUBJECTS, NAMING))


def both(judge: EndpointPolicy, transport: Transport, rows: Sequence[EdgeRow], limit: int) -> list[EdgeComparison]:
    labels = label(judge, rows)
    asking = Asking(Tier.DECISION, limit, lambda _name, _subject: None)
    slow, fast = (TransportComparison("fake", transport, ENCLAVES, explain, asking) for _ in range(2))
    slow.edges(chain.from_iterable(rows), labels)
    slow.halves(rows, labels, judge)
    transport.asked.clear()
    fast.all_endpoints(rows, labels, judge)
    return [slow.result(), fast.result()]


@given(
    st.sets(st.tuples(st.sampled_from(SUBJECTS), st.sampled_from(ENDPOINTS))),
    st.lists(st.sampled_from(REQUESTS), unique=True, min_size=1),
    st.sampled_from(("", *SUBJECTS)),
    st.integers(0, 6),
)
def test_the_same_as_edge_by_edge(
    judge: EndpointPolicy, admitted: set[tuple[str, Edge]], requests: list[Edge], refuses: str, limit: int
) -> None:
    column = Column(tuple(requests))
    rows = [EdgeRow(subject, column) for subject in SUBJECTS]
    transport = Transport(frozenset(admitted), refuses)
    slow, fast = both(judge, transport, rows, limit)
    assert fast == slow
    assert len(transport.asked) <= len(fast.findings)


def test_the_labels_of_a_row_are_those_of_its_edges(judge: EndpointPolicy) -> None:
    for subject in SUBJECTS:
        row = EdgeRow(subject, Column(REQUESTS))
        assert judge.labels(row) == bytes(judge.decide(edge).allowed for edge in row)
    assert any(judge.labels(EdgeRow("/a", Column(REQUESTS))))
