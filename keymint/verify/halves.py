# SPDX-License-Identifier: Apache-2.0
"""Find single endpoints that a transport allows although it denies the service, action or parameter.

A transport allows a ROS service only if it allows both of its topics. The edge of the service does not show a document
that permits one of them, although a subject that may publish requests can already make a server act.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from comarmor.values import dataclass
from keymint.api import Enclave, Transport, Verdict
from keymint.graph import Edge
from keymint.verify.compare import Explain, label_by_subject
from keymint.verify.endpoint_policy import EndpointPolicy
from keymint.verify.mismatch import Comparison
from keymint.verify.rows import RAW, Naming


@dataclass(frozen=True, slots=True)
class _Composites:
    """The endpoints of each edge of a subject that has several, and the endpoints that are edges themselves."""

    endpoints: Sequence[Sequence[Edge]]
    known: frozenset[Edge]


def with_halves(
    outcome: Comparison,
    transport: Transport,
    enclaves: Mapping[str, Enclave],
    edges: Iterable[Edge],
    allowed: Iterable[int],
    policy: EndpointPolicy,
    namings: Mapping[str, Naming],
    explain: Explain,
    limit: int,
) -> Comparison:
    """Add the endpoints that are false positives to a comparison, each as an edge of its own.

    An endpoint is omitted if its edge is a false positive already.

    Args:
        outcome: the comparison of the edges.
        transport: the transport.
        enclaves: the enclave of each subject of the edges.
        edges: the edges, grouped by subject.
        allowed: the policy's label of each edge: 1 allowed, 0 denied.
        policy: the policy on endpoints.
        namings: the naming of each subject that has one.
        explain: returns mismatches with their reasons.
        limit: mismatches to keep; all are counted.

    Raises:
        KeymintError: the transport does not work.
    """
    waiting: dict[str, _Composites] = {}
    findings = list(outcome.findings)
    wrong = dict(outcome.wrong)
    count = 0
    endpoints = _endpoints(zip(edges, allowed, strict=True), namings, waiting)
    for subject, labelled in label_by_subject(transport, enclaves, endpoints, outcome.tier):
        verdicts = dict(labelled)
        half_edges = [each for each in _halves(waiting.pop(subject), verdicts) if not policy.decide(each).allowed]
        if half_edges:
            count += len(half_edges)
            wrong[subject] = wrong.get(subject, 0) + len(half_edges)
            kept = half_edges[: max(0, limit - len(findings))]
            if kept:
                findings += explain(outcome.transport, enclaves[subject], [(each, verdicts[each]) for each in kept])
    confusion = replace(outcome.confusion, false_positive=outcome.confusion.false_positive + count)
    endpoints_found = len(findings) - len(outcome.findings)
    return replace(outcome, confusion=confusion, findings=tuple(findings), wrong=wrong, endpoints=endpoints_found)


def _endpoints(
    edges: Iterable[tuple[Edge, int]], namings: Mapping[str, Naming], waiting: dict[str, _Composites]
) -> Iterator[Edge]:
    """Yield the endpoints of denied edges with several endpoints, each once, grouped by subject.

    Args:
        edges: the edges with the policy's labels, grouped by subject.
        namings: the naming of each subject that has one.
        waiting: receives the composites of a subject before its first endpoint is yielded.
    """
    for subject, group in groupby(edges, key=lambda labelled: labelled[0].subject):
        naming = namings.get(subject)
        if naming is None:
            continue
        known, composites = set[Edge](), list[Sequence[Edge]]()
        for edge, allowed in group:
            if edge.object.kind == RAW:
                known.add(edge)
            elif len(needed := naming.endpoints(edge)) > 1 and not allowed:
                composites.append(needed)
        if composites:
            waiting[subject] = _Composites(composites, frozenset(known))
            yield from dict.fromkeys(endpoint for needed in composites for endpoint in needed)


def _halves(composites: _Composites, verdicts: Mapping[Edge, Verdict]) -> Sequence[Edge]:
    """Return the allowed endpoints that belong to no edge with all endpoints allowed."""
    allowed = {endpoint for endpoint, verdict in verdicts.items() if verdict.allowed} - composites.known
    for needed in composites.endpoints:
        if all(verdicts[endpoint].allowed for endpoint in needed):
            allowed.difference_update(needed)
    return sorted(allowed)
