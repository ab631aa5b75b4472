# SPDX-License-Identifier: Apache-2.0
"""Compare the labels of a transport with those of the policy, keeping only counts and mismatches.

A transport allows a ROS service only if it allows both of its topics. The edge of the service does not show a document
that permits one of them, although a subject that may publish requests can already make a server act. So the endpoints
of services, actions and parameters that a transport denies are compared too; an endpoint that it allows alone is a
false positive of its own, a *half*.

Most transports answer edge by edge (:meth:`TransportComparison.edges`, and after it
:meth:`TransportComparison.halves`). One that decides about all endpoints of a subject at once is asked about edges for
the reasons of mismatches only (:meth:`TransportComparison.all_endpoints`); the result is the same.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, groupby
from operator import and_, attrgetter

from comarmor.values import Data, field, replace
from keymint.api import InstalledEnclave, PolicyDecision, Tier, Transport, Verdict
from keymint.api.graph import ConfusionMatrix, Edge, EdgeOutcome
from keymint.errors import KeymintError, Origin
from keymint.verify.endpoint_policy import EdgeRow, EndpointPolicy, MappedColumn, labelled_rows, mapped_column

ENCLAVE_REFUSED = "enclave-refused"
"""Code of the error of a transport that refuses a complete enclave."""


class Mismatch(Data):
    """An edge that a transport labels differently from the policy, with the reason.

    Attributes:
        edge: the edge.
        policy: the policy's decision.
        verdict: the transport's decision, in its own words.
        reason: one line, from the simulation of the transport if there is one.
        document: the rule in a document that decided; without a line if no rule did.
        model: the simulated transport that explains the verdict of a real one, or empty.
    """

    edge: Edge
    policy: PolicyDecision
    verdict: Verdict
    reason: str
    document: Origin
    model: str = ""

    @property
    def error(self) -> EdgeOutcome:
        """How the edge is labelled wrongly: false positive or false negative."""
        return EdgeOutcome.FALSE_POSITIVE if self.verdict.allowed else EdgeOutcome.FALSE_NEGATIVE


class EdgeComparison(Data):
    """The comparison of one transport with the policy.

    Attributes:
        transport: its name.
        version: its version.
        tier: the tier of the test.
        confusion: counts of all edges.
        findings: the first mismatches, in the order of the edges.
        wrong: number of mismatches by subject.
        endpoints: number of findings, at the end, that are single endpoints of an edge.
    """

    transport: str
    version: str
    tier: Tier
    confusion: ConfusionMatrix
    findings: tuple[Mismatch, ...]
    wrong: Mapping[str, int]
    endpoints: int = 0

    @property
    def omitted(self) -> int:
        """Number of mismatches that are counted but not kept."""
        return self.confusion.errors - len(self.findings)


class Tally:
    """What a transport was asked, and what it answered.

    Attributes:
        rows: by permission, the numbers of edges that were asked, decided as the policy does, and denied.
        texts: number of denials by the transport's words.
    """

    def __init__(self) -> None:
        self.rows: dict[str, list[int]] = {}
        self.texts: Counter[str] = Counter()

    def add(self, edge: Edge, verdict: Verdict, *, agreed: bool) -> None:
        """Count a verdict on an edge."""
        row = self.rows.setdefault(edge.permission, [0, 0, 0])
        for at, counts in enumerate((True, agreed, not verdict.allowed)):
            row[at] += counts
        if not verdict.allowed:
            self.texts[verdict.reason] += 1

    def json(self) -> dict[str, object]:
        """Return the members of ``keymint verify --ros --json``."""
        names = ("permission", "asked", "agreed", "denied")
        return {
            "operations": [dict(zip(names, (each, *row), strict=True)) for each, row in sorted(self.rows.items())],
            "denials": [{"text": text, "count": count} for text, count in self.texts.most_common()],
        }


Explain = Callable[[str, InstalledEnclave, list[tuple[Edge, Verdict]]], list[Mismatch]]
"""Returns the mismatches of one enclave, given the name of the transport and the edges with its verdicts."""


class Asking(Data):
    """How to ask transports.

    Attributes:
        tier: the tier of the test.
        limit: mismatches to keep for each transport; all are counted.
        on_subject: called with the name of a transport, or ``policy``, and a subject after all edges of the subject.
        tally: counts the answers, if any.
    """

    tier: Tier
    limit: int
    on_subject: Callable[[str, str], None]
    tally: Tally | None = None


class TransportComparison(Data, frozen=False, eq=False):
    """Compares one transport with the policy.

    Args:
        name: name of the transport.
        transport: the transport, which is usable.
        enclaves: the enclave of each subject of the edges.
        explain: returns mismatches with their reasons.
        asking: how to ask.
    """

    _name: str
    _transport: Transport
    _enclaves: Mapping[str, InstalledEnclave]
    _explain: Explain
    _asking: Asking
    _counts: list[list[int]] = field(default_factory=lambda: [[0, 0], [0, 0]])
    """Numbers of edges: first whether the policy allows them, then whether the transport does."""
    _findings: list[Mismatch] = field(default_factory=list)
    _endpoints: int = 0
    _wrong: dict[str, int] = field(default_factory=dict)

    def result(self) -> EdgeComparison:
        """Return the counts and the first mismatches; the last ones are of single endpoints."""
        (true_negative, false_positive), (false_negative, true_positive) = self._counts
        confusion = ConfusionMatrix(true_positive, false_negative, false_positive, true_negative)
        version, tier = self._transport.usable().version, self._asking.tier
        return EdgeComparison(self._name, version, tier, confusion, tuple(self._findings), self._wrong, self._endpoints)

    def edges(self, edges: Iterable[Edge], labels: Iterable[int]) -> None:
        """Compare edge by edge.

        Args:
            edges: grouped by subject.
            labels: the policy's label of each edge: 1 allowed, 0 denied.

        Raises:
            KeymintError: the transport does not work.
        """
        expected, tally = iter(labels), self._asking.tally
        for subject, labelled in self._labelled(edges):
            wrong: list[tuple[Edge, Verdict]] = []
            count, room = 0, self._room
            for edge, verdict in labelled:
                allowed = next(expected)
                decided = verdict.allowed if not verdict.partial else not allowed
                self._counts[allowed][decided] += 1
                if tally is not None:
                    tally.add(edge, verdict, agreed=allowed == decided)
                if allowed != decided:
                    count += 1
                    if count <= room:
                        wrong.append((edge, replace(verdict, allowed=decided)))
            if count:
                self._add(subject, count, wrong)
            self._asking.on_subject(self._name, subject)

    def halves(self, rows: Iterable[EdgeRow], labels: bytes | bytearray, policy: EndpointPolicy) -> None:
        """Add the endpoints that are false positives to a comparison edge by edge, each as an edge of its own.

        An endpoint is omitted if its edge is a false positive already.

        Args:
            rows: the edges.
            labels: the policy's label of each edge: 1 allowed, 0 denied.
            policy: the policy on endpoints, with the naming of each subject that has one.

        Raises:
            KeymintError: the transport does not work.
        """
        waiting: dict[str, tuple[EdgeRow, bytes, MappedColumn]] = {}
        of_edges = len(self._findings)

        def endpoints() -> Iterator[Edge]:
            """Yield the endpoints of denied edges with several endpoints, each once, grouped by subject."""
            for row, expected in labelled_rows(rows, labels):
                if row.subject in policy.namings:
                    column = mapped_column(row.column, policy.namings[row.subject])
                    waiting[row.subject] = row, expected, column
                    needed = dict.fromkeys(chain.from_iterable(column.denied(expected)))
                    yield from (row.edge(column.endpoints.requests[at]) for at in needed)

        for subject, labelled in self._labelled(endpoints()):
            verdicts = dict(labelled)
            row, expected, column = waiting.pop(subject)
            answers = (verdicts.get(row.edge(each)) for each in column.endpoints.requests)
            halves = _halves(row, expected, column, bytes(bool(each and each.allowed) for each in answers), policy)
            if halves:
                self._counts[0][1] += len(halves)
                self._add(subject, len(halves), [(each, verdicts[each]) for each in halves[: self._room]])
        self._endpoints = len(self._findings) - of_edges

    def all_endpoints(self, rows: Iterable[EdgeRow], labels: bytes | bytearray, policy: EndpointPolicy) -> None:
        """Compare a transport that decides about all endpoints of a subject at once, halves included.

        Args:
            rows: the edges.
            labels: the policy's label of each edge: 1 allowed, 0 denied.
            policy: the policy on endpoints, with the naming of each subject.

        Raises:
            KeymintError: the transport does not work.
        """
        single: dict[str, list[tuple[Edge, bool]]] = {}
        for row, expected in labelled_rows(rows, labels):
            column = mapped_column(row.column, policy.namings[row.subject])
            admitted = _admitted(self._transport, self._enclaves[row.subject], column, self._asking.tier)
            decided = column.allowed(admitted)
            if halves := _halves(row, expected, column, admitted, policy):
                single[row.subject] = [(edge, True) for edge in halves]
            if decided != expected:
                differing = [
                    (row.edge(request), bool(allowed))
                    for request, allowed, label in zip(row.column.requests, decided, expected, strict=True)
                    if allowed != label
                ]
                self._ask(row.subject, differing)
            both, by_policy, by_transport = sum(map(and_, expected, decided)), expected.count(1), decided.count(1)
            self._counts[1][1] += both
            self._counts[1][0] += by_policy - both
            self._counts[0][1] += by_transport - both
            self._counts[0][0] += len(expected) - by_policy - by_transport + both
            self._asking.on_subject(self._name, row.subject)
        of_edges = len(self._findings)
        for subject, edges in single.items():
            self._counts[0][1] += len(edges)
            self._ask(subject, edges)
        self._endpoints = len(self._findings) - of_edges

    @property
    def _room(self) -> int:
        """How many more mismatches are kept."""
        return max(0, self._asking.limit - len(self._findings))

    def _add(self, subject: str, count: int, kept: list[tuple[Edge, Verdict]]) -> None:
        """Count mismatches of a subject, and keep the first of them."""
        self._wrong[subject] = self._wrong.get(subject, 0) + count
        if kept:
            self._findings += self._explain(self._name, self._enclaves[subject], kept)

    def _labelled(self, edges: Iterable[Edge]) -> Iterator[tuple[str, Iterator[tuple[Edge, Verdict]]]]:
        """Yield the labelled edges of each subject.

        A transport that needs peers gets all enclaves at once. Others get one subject at a time, so that a refused
        enclave does not affect the rest.
        """
        if self._asking.tier is Tier.EXCHANGE:
            labelled = _answers(self._transport, tuple(self._enclaves.values()), edges, Tier.EXCHANGE, deque())
            yield from groupby(labelled, key=lambda item: item[0].subject)
            return
        for subject, group in groupby(edges, key=attrgetter("subject")):
            yield subject, label_enclave(self._transport, self._enclaves[subject], group, self._asking.tier)

    def _ask(self, subject: str, wrong: Sequence[tuple[Edge, bool]]) -> None:
        """Count mismatches of a subject; the transport is asked for its reasons of those that are kept."""
        first, enclave = dict(wrong[: self._room]), self._enclaves[subject]
        again = label_enclave(self._transport, enclave, first, self._asking.tier) if first else ()
        self._add(subject, len(wrong), [(edge, replace(verdict, allowed=first[edge])) for edge, verdict in again])


def _halves(row: EdgeRow, labels: bytes, column: MappedColumn, admitted: bytes, policy: EndpointPolicy) -> list[Edge]:
    """Return the endpoints of a row that a transport admits although the policy denies them and all that need them.

    Args:
        row: the edges of a subject.
        labels: which of them the policy allows.
        column: their endpoints.
        admitted: which endpoints the transport admits, at least of denied edges with several endpoints.
        policy: the policy on endpoints.
    """
    return [each for each in sorted(map(row.edge, column.halves(labels, admitted))) if not policy.decide(each).allowed]


def _admitted(transport: Transport, enclave: InstalledEnclave, column: MappedColumn, tier: Tier) -> bytes:
    """Return which endpoints a transport admits; none of a refused enclave."""
    try:
        return transport.admitted(enclave, column.endpoints, tier)
    except KeymintError as error:
        if error.diagnostics[0].code != ENCLAVE_REFUSED:
            raise
        return bytes(len(column.endpoints.requests))


def label_enclave(
    transport: Transport, enclave: InstalledEnclave, edges: Iterable[Edge], tier: Tier
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield the verdicts of a transport on the edges of one enclave; a refused enclave is denied everything.

    Raises:
        KeymintError: the transport does not work.
    """
    waiting = iter(edges)
    unanswered: deque[Edge] = deque()
    try:
        yield from _answers(transport, (enclave,), waiting, tier, unanswered)
    except KeymintError as error:
        diagnostic = error.diagnostics[0]
        if diagnostic.code != ENCLAVE_REFUSED:
            raise
        refused = Verdict(False, f"the enclave is refused: {diagnostic.message}", diagnostic.where)
        yield from ((edge, refused) for edge in chain(unanswered, waiting))


def _answers(
    transport: Transport, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier, pending: deque[Edge]
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield the verdicts of a transport; it must answer each edge once, in order.

    Args:
        transport: the transport.
        enclaves: the enclaves of all subjects of the edges.
        edges: edges to decide.
        tier: how deep to ask.
        pending: receives the edges that it has not answered yet.

    Raises:
        KeymintError: it skips an edge, or answers another one; see also :meth:`keymint.api.Transport.label`.
    """
    waiting = iter(edges)

    def asked() -> Iterator[Edge]:
        for edge in waiting:
            pending.append(edge)
            yield edge

    for edge, verdict in transport.label(enclaves, asked(), tier):
        if not pending or pending.popleft() != edge:
            message = "the transport answered another edge than the one it was asked"
            raise KeymintError(message, code="transport-answers")
        yield edge, verdict
    if pending or next(waiting, None) is not None:
        raise KeymintError("the transport left edges unanswered", code="transport-answers")
