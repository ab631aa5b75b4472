# SPDX-License-Identifier: Apache-2.0
"""Edges by rows, their endpoints on a transport, and what the policy decides about them there.

A row is a subject, and a column of requests that it may share with other subjects. What follows from a column alone, as
the endpoints of its requests, is computed once for all rows.

The policy is enforced on endpoints. Rules on ROS names and rules on names of the transport both apply there: an ALLOW
rule on a raw topic and a DENY rule on the ROS topic that it carries match the same endpoint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache

from comarmor.patterns import glob
from comarmor.patterns.glob import matcher
from comarmor.values import Data, replace
from keymint.api import LoadedPolicy, NameMapping, PolicyDecision
from keymint.api.graph import Column, Edge

RAW = "topic"


class Naming(Data):
    """The mapping of a subject's ROS names to names of its transport, for one distribution."""

    mapping: NameMapping
    distro: str

    def endpoints(self, edge: Edge) -> Sequence[Edge]:
        """Return the endpoints of an edge; see :meth:`keymint.api.NameMapping.endpoints`."""
        return self.mapping.endpoints(self.distro, edge)

    def meanings(self, endpoint: Edge) -> Sequence[Edge]:
        """Return the ROS edges of an endpoint; see :meth:`keymint.api.NameMapping.meanings`."""
        return self.mapping.meanings(self.distro, endpoint)


class EdgeRow(Data):
    """The edges of a subject: each request of a column."""

    subject: str
    column: Column

    def __len__(self) -> int:
        """Return the number of edges."""
        return len(self.column.requests)

    def __iter__(self) -> Iterator[Edge]:
        """Yield the edges."""
        return map(self.edge, self.column.requests)

    def edge(self, request: Edge) -> Edge:
        """Return a request of any subject as an edge of this one."""
        return Edge(self.subject, request.permission, request.object, request.domain)


EdgeRows = Callable[[], Iterator[EdgeRow]]
"""Returns the rows of all subjects, each time it is called."""


def labelled_rows(rows: Iterable[EdgeRow], labels: bytes | bytearray) -> Iterator[tuple[EdgeRow, bytes]]:
    """Yield each row with those of the labels, one byte for each edge of all rows, that are of its edges."""
    begin = 0
    for row in rows:
        yield row, bytes(labels[begin : begin + len(row)])
        begin += len(row)


class MappedColumn(Data, eq=False):
    """The endpoints of the requests of a column.

    Attributes:
        endpoints: each endpoint once.
        needed: the positions of the endpoints of each request.
        raw: the positions of the endpoints that are requests themselves.
        composite: the positions of the requests that need several endpoints.
    """

    endpoints: Column
    needed: tuple[tuple[int, ...], ...]
    raw: frozenset[int]
    composite: tuple[int, ...]

    def allowed(self, admitted: bytes) -> bytes:
        """Return which requests are allowed if these endpoints are: one byte each, 1 allowed, 0 denied."""
        return bytes(
            admitted[each[0]] if len(each) == 1 else bool(each) and all(admitted[at] for at in each)
            for each in self.needed
        )

    def denied(self, labels: bytes) -> list[tuple[int, ...]]:
        """Return the positions of the endpoints of each denied request that needs several of them."""
        return [self.needed[at] for at in self.composite if not labels[at]]

    def halves(self, labels: bytes, admitted: bytes) -> list[Edge]:
        """Return the admitted endpoints that only denied requests with several endpoints need.

        Args:
            labels: which requests the policy allows.
            admitted: which endpoints the transport admits, at least of those requests.
        """
        denied = self.denied(labels)
        found = {at for needed in denied for at in needed if admitted[at]} - self.raw
        for needed in denied if found else ():
            if all(admitted[at] for at in needed):
                found.difference_update(needed)
        return [self.endpoints.requests[at] for at in found]


@lru_cache(maxsize=4)
def mapped_column(column: Column, naming: Naming) -> MappedColumn:
    """Return the endpoints of the requests of a column.

    Raises:
        KeymintError: the distribution or a permission is unknown.
    """
    places: dict[Edge, int] = {}
    needed: list[tuple[int, ...]] = []
    raw: set[int] = set()
    for request in column.requests:
        positions = tuple(places.setdefault(each, len(places)) for each in naming.endpoints(request))
        if request.object.kind == RAW:
            raw.update(positions)
        needed.append(positions)
    composite = tuple(at for at, each in enumerate(needed) if len(each) > 1)
    return MappedColumn(Column(tuple(places)), tuple(needed), frozenset(raw), composite)


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
        """Decide an endpoint in each of its partitions separately; the mapping may give each another name.

        There its own name and its ROS names decide; deny overrides allow.
        """
        object_ = endpoint.object
        names = object_.partitions
        parts = [endpoint]
        if len(names) > 1:
            parts = [replace(endpoint, object=replace(object_, partitions=(name,) if name else ())) for name in names]
        found: list[PolicyDecision] = []
        for part in parts:
            decisions = [self._policy.decide(edge) for edge in (part, *naming.meanings(part))]
            denying = [decision for decision in decisions if not decision.allowed and decision.where]
            allowing = [decision for decision in decisions if decision.allowed]
            found.append((denying or allowing or decisions)[0])
        return self._together(found)

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
        plain, single = _by_permission(row.column)
        for (kind, permission), (positions, names) in plain.items():
            decided = self._policy.allowed(row.subject, kind, permission, names)
            for at, allowed in zip(positions, decided, strict=True):
                labels[at] = allowed
        naming, is_raw = self.namings.get(row.subject), self._raw_test(row.subject)
        if naming and is_raw:  # a rule on raw topics may match an endpoint of a request on a ROS name
            column = mapped_column(row.column, naming)
            raw = [is_raw(each.object.name) for each in column.endpoints.requests]
            single = [*single, *(at for at, needed in enumerate(column.needed) if any(raw[each] for each in needed))]
        for at in single:
            labels[at] = self.decide(row.edge(requests[at])).allowed
        return bytes(labels)


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
