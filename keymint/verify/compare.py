# SPDX-License-Identifier: Apache-2.0
"""Compare the labels of a transport with those of the policy, keeping only counts and mismatches."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from operator import attrgetter

from comarmor.values import dataclass
from keymint.api import Enclave, Tier, Transport, Verdict
from keymint.api.graph import ConfusionMatrix, Edge
from keymint.errors import KeymintError
from keymint.verify.mismatch import Comparison, Mismatch
from keymint.verify.tally import Tally

ENCLAVE_REFUSED = "enclave-refused"
"""Code of the error of a transport that refuses a complete enclave."""

Explain = Callable[[str, Enclave, list[tuple[Edge, Verdict]]], list[Mismatch]]
"""Returns the mismatches of one enclave, given the name of the transport and the edges with its verdicts."""


@dataclass(frozen=True, slots=True)
class Asking:
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


def compare(
    name: str,
    transport: Transport,
    enclaves: Mapping[str, Enclave],
    edges: Iterable[Edge],
    labels: Iterable[int],
    explain: Explain,
    asking: Asking,
) -> Comparison:
    """Compare one transport with the policy.

    Args:
        name: the transport's name.
        transport: a usable transport.
        enclaves: the enclave of each subject of the edges.
        edges: grouped by subject.
        labels: the policy's label of each edge: 1 allowed, 0 denied.
        explain: returns mismatches with their reasons.
        asking: how to ask.

    Raises:
        KeymintError: the transport does not work.
    """
    expected = iter(labels)
    counts = [[0, 0], [0, 0]]
    findings: list[Mismatch] = []
    by_subject: dict[str, int] = {}
    for subject, labelled in label_by_subject(transport, enclaves, edges, asking.tier):
        wrong: list[tuple[Edge, Verdict]] = []
        for edge, verdict in labelled:
            allowed = next(expected)
            decided = verdict.allowed if not verdict.partial else not allowed
            counts[allowed][decided] += 1
            if asking.tally is not None:
                asking.tally.add(edge, verdict, agreed=allowed == decided)
            if allowed != decided:
                by_subject[subject] = by_subject.get(subject, 0) + 1
                if len(findings) + len(wrong) < asking.limit:
                    wrong.append((edge, replace(verdict, allowed=decided)))
        if wrong:
            findings += explain(name, enclaves[subject], wrong)
        asking.on_subject(name, subject)
    (true_negative, false_positive), (false_negative, true_positive) = counts
    confusion = ConfusionMatrix(true_positive, false_negative, false_positive, true_negative)
    return Comparison(name, transport.usable().version, asking.tier, confusion, tuple(findings), by_subject)


def label_by_subject(
    transport: Transport, enclaves: Mapping[str, Enclave], edges: Iterable[Edge], tier: Tier
) -> Iterator[tuple[str, Iterator[tuple[Edge, Verdict]]]]:
    """Yield the labelled edges of each subject.

    A transport that needs peers gets all enclaves at once. Others get one subject at a time, so that a refused enclave
    does not affect the rest.
    """
    if tier is Tier.EXCHANGE:
        labelled = _answers(transport, tuple(enclaves.values()), edges, tier, deque())
        yield from groupby(labelled, key=lambda item: item[0].subject)
        return
    for subject, group_of_edges in groupby(edges, key=attrgetter("subject")):
        yield subject, label_enclave(transport, enclaves[subject], group_of_edges, tier)


def label_enclave(
    transport: Transport, enclave: Enclave, edges: Iterable[Edge], tier: Tier
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
        yield from ((edge, refused) for edge in unanswered)
        yield from ((edge, refused) for edge in waiting)


def _answers(
    transport: Transport, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier, unanswered: deque[Edge]
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield the verdicts of a transport; it must answer each edge once, in order.

    Args:
        transport: the transport.
        enclaves: the enclaves of all subjects of the edges.
        edges: edges to decide.
        tier: how deep to ask.
        unanswered: receives the edges that it has not answered yet.

    Raises:
        KeymintError: it skips an edge, or answers another one; see also :meth:`keymint.api.Transport.label`.
    """
    waiting = iter(edges)

    def pending() -> Iterator[Edge]:
        for edge in waiting:
            unanswered.append(edge)
            yield edge

    for edge, verdict in transport.label(enclaves, pending(), tier):
        if not unanswered or unanswered.popleft() != edge:
            raise KeymintError(
                "the transport answered another edge than the one it was asked", code="transport-answers"
            )
        yield edge, verdict
    if unanswered or next(waiting, None) is not None:
        raise KeymintError("the transport left edges unanswered", code="transport-answers")
