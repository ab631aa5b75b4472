# SPDX-License-Identifier: Apache-2.0
"""Compare the labels of a transport that decides about all endpoints of a subject at once with those of the policy.

The transport is asked about edges only for the reasons of mismatches. The result is that of :mod:`.compare` followed by
:mod:`.halves`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from operator import and_

from keymint.api import Enclave, EndpointTransport, Tier
from keymint.api.graph import ConfusionMatrix, Edge
from keymint.errors import KeymintError
from keymint.verify.compare import ENCLAVE_REFUSED, Asking, Explain, label_enclave
from keymint.verify.endpoint_policy import EndpointPolicy
from keymint.verify.halves import halves
from keymint.verify.mismatch import Comparison, Mismatch
from keymint.verify.rows import EdgeRow, MappedColumn, labelled_rows, mapped


def compare_endpoints(
    name: str,
    transport: EndpointTransport,
    enclaves: Mapping[str, Enclave],
    rows: Iterable[EdgeRow],
    labels: bytes | bytearray,
    policy: EndpointPolicy,
    explain: Explain,
    asking: Asking,
) -> Comparison:
    """Compare one transport with the policy.

    Args:
        name: the transport's name.
        transport: a usable transport.
        enclaves: the enclave of each subject of the edges.
        rows: the edges.
        labels: the policy's label of each edge: 1 allowed, 0 denied.
        policy: the policy on endpoints, with the naming of each subject.
        explain: returns mismatches with their reasons.
        asking: how to ask.

    Raises:
        KeymintError: the transport does not work.
    """

    def kept(subject: str, decided: Sequence[tuple[Edge, bool]]) -> list[Mismatch]:
        """Return the first of some mismatches."""
        first = dict(decided[: max(0, asking.limit - len(findings))])
        if not first:
            return []
        again = label_enclave(transport, enclaves[subject], first, asking.tier)
        counted = [(edge, replace(verdict, allowed=first[edge])) for edge, verdict in again]
        return explain(name, enclaves[subject], counted)

    findings: list[Mismatch] = []
    single: dict[str, list[tuple[Edge, bool]]] = {}
    wrong: dict[str, int] = {}
    both = by_policy = by_transport = 0
    for row, expected in labelled_rows(rows, labels):
        column = mapped(row.column, policy.namings[row.subject])
        admitted = _admitted(transport, enclaves[row.subject], column, asking.tier)
        decided = column.allowed(admitted)
        if half_edges := halves(row, expected, column, admitted, policy):
            single[row.subject] = [(edge, True) for edge in half_edges]
        if decided != expected:
            differing = [
                (row.edge(request), bool(allowed))
                for request, allowed, label in zip(row.column.requests, decided, expected, strict=True)
                if allowed != label
            ]
            wrong[row.subject] = len(differing)
            findings += kept(row.subject, differing)
        both += sum(map(and_, expected, decided))
        by_policy += expected.count(1)
        by_transport += decided.count(1)
        asking.on_subject(name, row.subject)
    of_edges = len(findings)
    for subject, found in single.items():
        wrong[subject] = wrong.get(subject, 0) + len(found)
        findings += kept(subject, found)
    false_positive = by_transport - both + sum(map(len, single.values()))
    confusion = ConfusionMatrix(both, by_policy - both, false_positive, len(labels) - by_policy - by_transport + both)
    version, of_endpoints = transport.usable().version, len(findings) - of_edges
    return Comparison(name, version, asking.tier, confusion, tuple(findings), wrong, of_endpoints)


def _admitted(transport: EndpointTransport, enclave: Enclave, column: MappedColumn, tier: Tier) -> bytes:
    """Return which endpoints a transport admits; none of a refused enclave."""
    try:
        return transport.admitted(enclave, column.endpoints, tier)
    except KeymintError as error:
        if error.diagnostics[0].code != ENCLAVE_REFUSED:
            raise
        return bytes(len(column.endpoints.requests))
