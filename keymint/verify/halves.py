# SPDX-License-Identifier: Apache-2.0
"""Find single endpoints that a transport allows although it denies the service, action or parameter.

A transport allows a ROS service only if it allows both of its topics. The edge of the service does not show a document
that permits one of them, although a subject that may publish requests can already make a server act.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain

from keymint.api import Enclave, Transport
from keymint.api.graph import Edge
from keymint.verify.compare import Explain, label_by_subject
from keymint.verify.endpoint_policy import EndpointPolicy
from keymint.verify.mismatch import Comparison
from keymint.verify.rows import EdgeRow, MappedColumn, Naming, labelled_rows, mapped


def with_halves(
    outcome: Comparison,
    transport: Transport,
    enclaves: Mapping[str, Enclave],
    rows: Iterable[EdgeRow],
    labels: bytes | bytearray,
    policy: EndpointPolicy,
    explain: Explain,
    limit: int,
) -> Comparison:
    """Add the endpoints that are false positives to a comparison, each as an edge of its own.

    An endpoint is omitted if its edge is a false positive already.

    Args:
        outcome: the comparison of the edges.
        transport: the transport.
        enclaves: the enclave of each subject of the edges.
        rows: the edges.
        labels: the policy's label of each edge: 1 allowed, 0 denied.
        policy: the policy on endpoints, with the naming of each subject that has one.
        explain: returns mismatches with their reasons.
        limit: mismatches to keep; all are counted.

    Raises:
        KeymintError: the transport does not work.
    """
    waiting: dict[str, tuple[EdgeRow, bytes, MappedColumn]] = {}
    findings = list(outcome.findings)
    wrong = dict(outcome.wrong)
    count = 0
    endpoints = _endpoints(labelled_rows(rows, labels), policy.namings, waiting)
    for subject, labelled in label_by_subject(transport, enclaves, endpoints, outcome.tier):
        verdicts = dict(labelled)
        row, expected, column = waiting.pop(subject)
        asked = (verdicts.get(row.edge(each)) for each in column.endpoints.requests)
        found = halves(row, expected, column, bytes(bool(each and each.allowed) for each in asked), policy)
        if found:
            count += len(found)
            wrong[subject] = wrong.get(subject, 0) + len(found)
            kept = found[: max(0, limit - len(findings))]
            if kept:
                findings += explain(outcome.transport, enclaves[subject], [(each, verdicts[each]) for each in kept])
    confusion = replace(outcome.confusion, false_positive=outcome.confusion.false_positive + count)
    endpoints_found = len(findings) - len(outcome.findings)
    return replace(outcome, confusion=confusion, findings=tuple(findings), wrong=wrong, endpoints=endpoints_found)


def _endpoints(
    rows: Iterable[tuple[EdgeRow, bytes]],
    namings: Mapping[str, Naming],
    waiting: dict[str, tuple[EdgeRow, bytes, MappedColumn]],
) -> Iterator[Edge]:
    """Yield the endpoints of denied edges with several endpoints, each once, grouped by subject.

    Args:
        rows: the edges with the policy's labels.
        namings: the naming of each subject that has one.
        waiting: receives the row of a subject before its first endpoint is yielded.
    """
    for row, expected in rows:
        if row.subject in namings:
            column = mapped(row.column, namings[row.subject])
            waiting[row.subject] = row, expected, column
            needed = dict.fromkeys(chain.from_iterable(column.denied(expected)))
            yield from (row.edge(column.endpoints.requests[at]) for at in needed)


def halves(row: EdgeRow, labels: bytes, column: MappedColumn, admitted: bytes, policy: EndpointPolicy) -> list[Edge]:
    """Return the endpoints of a row that a transport admits although the policy denies them and all that need them.

    Args:
        row: the edges of a subject.
        labels: which of them the policy allows.
        column: their endpoints.
        admitted: which endpoints the transport admits, at least of denied edges with several endpoints.
        policy: the policy on endpoints.
    """
    return [each for each in sorted(map(row.edge, column.halves(labels, admitted))) if not policy.decide(each).allowed]
