# SPDX-License-Identifier: Apache-2.0
"""Decide edges by the policy where it is enforced: on the endpoints of a transport.

Rules on ROS names and rules on names of the transport both apply there: an ALLOW rule on a
raw topic and a DENY rule on the ROS topic that it carries match the same endpoint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

from comarmor.patterns import glob
from comarmor.patterns.glob import matcher
from keymint.api import LoadedPolicy, PolicyDecision, RowPolicy
from keymint.api.graph import Column, Edge
from keymint.verify.rows import RAW, EdgeRow, Naming, mapped_column


class EndpointPolicy:
    """A policy, applied to the endpoints of its subjects.

    Args:
        policy: the policy.
        namings: the naming of each subject that has one; names of other subjects are not mapped.
    """

    def __init__(self, policy: LoadedPolicy, namings: Mapping[str, Naming]) -> None:
        self._policy = policy
        self.namings = namings
        self._raw_test = lru_cache(maxsize=1)(self._test_of_raw_rules)  # edges are grouped by subject

    def decide(self, edge: Edge) -> PolicyDecision:
        """Return the policy's decision on an edge.

        Raises:
            KeymintError: the kind or the permission is not known.
        """
        naming = self.namings.get(edge.subject)
        if naming is None:
            return self._policy.decide(edge)
        if edge.object.kind == RAW:
            return self._endpoint(edge, naming) if naming.meanings(edge) else self._policy.decide(edge)
        is_raw = self._raw_test(edge.subject)
        endpoints = naming.endpoints(edge)
        if not (is_raw and any(is_raw(endpoint.object.name) for endpoint in endpoints)):
            return self._policy.decide(edge)
        return self._together([self._endpoint(endpoint, naming) for endpoint in endpoints])

    def _endpoint(self, endpoint: Edge, naming: Naming) -> PolicyDecision:
        """Decide an endpoint in each of its partitions separately; the mapping may give each another name."""
        return self._together([self._in_partition(each, naming) for each in _apart(endpoint)])

    def _in_partition(self, endpoint: Edge, naming: Naming) -> PolicyDecision:
        """Decide an endpoint by its own name and its ROS names; deny overrides allow."""
        decisions = [self._policy.decide(edge) for edge in (endpoint, *naming.meanings(endpoint))]
        denying = [decision for decision in decisions if not decision.allowed and decision.where]
        allowing = [decision for decision in decisions if decision.allowed]
        return (denying or allowing or decisions)[0]

    @staticmethod
    def _together(decisions: Sequence[PolicyDecision]) -> PolicyDecision:
        """Return the first denial, or the first decision if all allow."""
        return next((decision for decision in decisions if not decision.allowed), decisions[0])

    def _test_of_raw_rules(self, subject: str) -> Callable[[str], bool] | None:
        """Return a function that tells whether a rule of a subject on raw topics matches a name; None without rules."""
        rules = self._policy.rules(subject)
        raw = [glob.parse(e) for rule in (rules.rules if rules else ()) if rule.kind == RAW for e in rule.expressions]
        exact = {text for each in raw if (text := glob.literal(each)) is not None}
        patterns = [matcher(each) for each in raw if glob.literal(each) is None]
        return (lambda name: name in exact or any(matches(name) for matches in patterns)) if raw else None

    def labels(self, row: EdgeRow) -> bytes:
        """Return the policy's labels of a row of edges, one byte each: 1 allowed, 0 denied.

        Raises:
            KeymintError: the kind or the permission of an edge is not known.
        """
        labels = bytearray(len(row))
        requests = row.column.requests
        single: Sequence[int] = range(len(row))
        if isinstance(self._policy, RowPolicy):
            plain, single = _by_permission(row.column)
            for (kind, permission), (positions, names) in plain.items():
                decided = self._policy.allowed(row.subject, kind, permission, names)
                for at, allowed in zip(positions, decided, strict=True):
                    labels[at] = allowed
            single = [*single, *self._meeting_raw_rules(row)]
        for at in single:
            labels[at] = self.decide(row.edge(requests[at])).allowed
        return bytes(labels)

    def _meeting_raw_rules(self, row: EdgeRow) -> Iterator[int]:
        """Yield the requests on ROS names of which a rule on raw topics matches an endpoint."""
        naming, is_raw = self.namings.get(row.subject), self._raw_test(row.subject)
        if naming is None or is_raw is None:
            return
        column = mapped_column(row.column, naming)
        raw = [is_raw(each.object.name) for each in column.endpoints.requests]
        yield from (at for at, needed in enumerate(column.needed) if any(raw[each] for each in needed))


@lru_cache(maxsize=4)
def _by_permission(
    column: Column,
) -> tuple[Mapping[tuple[str, str], tuple[Sequence[int], Sequence[str]]], Sequence[int]]:
    """Return positions and names of the requests on ROS names by kind and permission, and the other positions."""
    plain: dict[tuple[str, str], tuple[list[int], list[str]]] = {}
    others: list[int] = []
    for at, request in enumerate(column.requests):
        if request.object.kind == RAW or request.object.partitions:
            others.append(at)
        else:
            positions, names = plain.setdefault((request.object.kind, request.permission), ([], []))
            positions.append(at)
            names.append(request.object.name)
    return plain, others


def _apart(endpoint: Edge) -> Sequence[Edge]:
    """Return an endpoint for each of its partitions."""
    names = endpoint.object.partitions
    if len(names) < 2:  # noqa: PLR2004 - nothing to take apart
        return (endpoint,)
    return [replace(endpoint, object=replace(endpoint.object, partitions=(name,) if name else ())) for name in names]


def label(
    policy: EndpointPolicy, rows: Iterable[EdgeRow], on_subject: Callable[[str], None] = lambda _subject: None
) -> bytearray:
    """Return the policy's labels of edges, one byte each: 1 allowed, 0 denied.

    Args:
        policy: the policy on endpoints.
        rows: the edges.
        on_subject: called after all edges of a subject.

    Raises:
        KeymintError: the kind or the permission of an edge is not known.
    """
    labels = bytearray()
    for row in rows:
        labels += policy.labels(row)
        on_subject(row.subject)
    return labels
