# SPDX-License-Identifier: Apache-2.0
"""Labels are compared as they come, whatever a transport does meanwhile."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import Origin, Reason
from keymint.api import Availability, InstalledEnclave, PolicyDecision, Tier, Verdict
from keymint.api.graph import ConfusionMatrix, Edge, Graph, Object, complete
from keymint.errors import KeymintError
from keymint.verify.compare import ENCLAVE_REFUSED, Asking, EdgeComparison, Mismatch, TransportComparison, label_enclave

ENCLAVES = {
    name: InstalledEnclave(name, Path("/nowhere") / name[1:], "humble", Path("/nowhere")) for name in ("/a", "/b", "/c")
}


@dataclass
class Transport:
    """Allows some edges, reads some ahead, and refuses some enclaves."""

    allowed: frozenset[Edge] = frozenset()
    ahead: int = 0
    refuses: str = ""
    code: str = ENCLAVE_REFUSED
    asked: list[tuple[tuple[str, ...], Tier]] = field(default_factory=list)

    def usable(self) -> Availability:
        return Availability(True, "9", tiers=(Tier.DECISION, Tier.EXCHANGE))

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        self.asked.append((tuple(enclave.subject for enclave in enclaves), tier))
        waiting: list[Edge] = []
        for edge in edges:
            waiting.append(edge)
            if len(waiting) > self.ahead:
                yield self._decided(waiting.pop(0))
        yield from map(self._decided, waiting)

    def _decided(self, edge: Edge) -> tuple[Edge, Verdict]:
        if edge.subject == self.refuses:
            raise KeymintError("the grant is for another", code=self.code)
        return edge, Verdict(edge in self.allowed)


def explain(name: str, enclave: InstalledEnclave, wrong: list[tuple[Edge, Verdict]]) -> list[Mismatch]:
    return [
        Mismatch(
            edge,
            PolicyDecision(not verdict.allowed, None, Reason(("",))),
            verdict,
            verdict.reason,
            Origin("x"),
        )
        for edge, verdict in wrong
    ]


def compare(
    transport: Transport, edges: Iterable[Edge], labels: Iterable[int], tier: Tier, limit: int
) -> EdgeComparison:
    comparison = TransportComparison(
        "fake", transport, ENCLAVES, explain, Asking(tier, limit, lambda _name, _subject: None)
    )
    comparison.edges(edges, labels)
    return comparison.result()


def graph(objects: int = 3) -> list[Edge]:
    edges = [Edge("/a", "ros_publish", Object("ros_topic", f"/t{n}")) for n in range(objects)]
    return list(complete(Graph.of(edges, ENCLAVES)))


EDGES = graph()


def held(transport: Transport, said: Sequence[int], tier: Tier = Tier.DECISION, limit: int = 1000):
    return compare(transport, iter(EDGES), said, tier, limit)


@given(
    st.sets(st.sampled_from(EDGES)),
    st.sets(st.sampled_from(EDGES)),
    st.integers(0, 7),
    st.sampled_from([Tier.DECISION, Tier.EXCHANGE]),
)
def test_counts_and_findings(allowed: set[Edge], said: set[Edge], ahead: int, tier: Tier) -> None:
    outcome = held(Transport(frozenset(allowed), ahead), [edge in said for edge in EDGES], tier)
    assert outcome.confusion == ConfusionMatrix(
        len(allowed & said), len(said - allowed), len(allowed - said), len(set(EDGES) - allowed - said)
    )
    assert [finding.edge for finding in outcome.findings] == [edge for edge in EDGES if edge in allowed ^ said]
    assert sum(outcome.wrong.values()) == outcome.confusion.errors
    assert outcome.omitted == 0


def test_a_limit_bounds_what_is_kept_not_what_is_counted() -> None:
    outcome = held(Transport(), [1] * len(EDGES), limit=4)
    assert (len(outcome.findings), outcome.omitted) == (4, len(EDGES) - 4)
    assert outcome.confusion.false_negative == len(EDGES)


@pytest.mark.parametrize("ahead", [0, 1, 100])
def test_an_enclave_that_is_refused_says_nothing_of_the_others(ahead: int) -> None:
    outcome = held(Transport(frozenset(EDGES), ahead, refuses="/b"), [1] * len(EDGES))
    assert outcome.wrong == {"/b": 6}
    assert {finding.edge.subject for finding in outcome.findings} == {"/b"}
    assert all("the grant is for another" in finding.reason for finding in outcome.findings)


def test_a_transport_that_does_not_work_is_an_error() -> None:
    with pytest.raises(KeymintError, match="the grant is for another"):
        held(Transport(refuses="/b", code="transport-failed"), [1] * len(EDGES))


def test_peers_are_there_where_data_is_exchanged() -> None:
    transport = Transport()
    held(transport, [0] * len(EDGES), Tier.EXCHANGE)
    assert transport.asked == [(tuple(ENCLAVES), Tier.EXCHANGE)]
    transport = Transport()
    held(transport, [0] * len(EDGES))
    assert transport.asked == [((subject,), Tier.DECISION) for subject in ENCLAVES]


def test_memory_does_not_grow_with_the_edges() -> None:
    objects = 20_000
    edges = (
        Edge(subject, "ros_publish", Object("ros_topic", f"/t{n}")) for subject in ENCLAVES for n in range(objects)
    )
    tracemalloc.start()
    compare(Transport(), edges, bytes(3 * objects), Tier.DECISION, 10)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000


@pytest.mark.parametrize("tier", [Tier.DECISION, Tier.EXCHANGE])
@pytest.mark.parametrize("fault", ["leaves one out", "stops early", "answers twice"])
def test_a_transport_that_does_not_answer_what_it_is_asked_is_an_error(tier: Tier, fault: str) -> None:
    """Labels shifted by one would be compared with the wrong edges."""

    class Faulty(Transport):
        def label(self, enclaves, edges, tier):
            for at, each in enumerate(super().label(enclaves, edges, tier)):
                if at == 1 and fault == "stops early":
                    return
                if at != 1 or fault != "leaves one out":
                    yield each
                if at == 1 and fault == "answers twice":
                    yield each

    with pytest.raises(KeymintError, match="the transport"):
        held(Faulty(), [0] * len(EDGES), tier)


def test_a_refused_enclave_answers_each_edge_once() -> None:
    edges = [edge for edge in EDGES if edge.subject == "/b"]
    found = list(label_enclave(Transport(refuses="/b"), ENCLAVES["/b"], edges, Tier.DECISION))
    assert [edge for edge, _ in found] == edges


@pytest.mark.parametrize("label", [0, 1])
def test_a_partial_permission_is_a_mismatch_whatever_the_policy_says(label: int) -> None:
    edge = graph(1)[0]

    class Partial(Transport):
        def _decided(self, edge: Edge) -> tuple[Edge, Verdict]:
            return edge, Verdict(False, "in part", partial=True)

    outcome = compare(Partial(), [edge], [label], Tier.DECISION, 9)
    assert outcome.confusion == ConfusionMatrix(false_negative=label, false_positive=1 - label)
    [finding] = outcome.findings
    assert finding.verdict.allowed != bool(label)
