# SPDX-License-Identifier: Apache-2.0
"""Edges by rows: a subject, and a column of requests that it may share with other subjects.

What follows from a column alone, as the endpoints of its requests, is computed once for all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache

from comarmor.values import dataclass
from keymint.api import NameMapping
from keymint.api.graph import Column, Edge

RAW = "topic"


@dataclass(frozen=True, slots=True)
class Naming:
    """The mapping of a subject's ROS names to names of its transport, for one distribution."""

    mapping: NameMapping
    distro: str

    def endpoints(self, edge: Edge) -> Sequence[Edge]:
        """Return the endpoints of an edge; see :meth:`keymint.api.NameMapping.endpoints`."""
        return self.mapping.endpoints(self.distro, edge)

    def meanings(self, endpoint: Edge) -> Sequence[Edge]:
        """Return the ROS edges of an endpoint; see :meth:`keymint.api.NameMapping.meanings`."""
        return self.mapping.meanings(self.distro, endpoint)


@dataclass(frozen=True, slots=True)
class EdgeRow:
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


@dataclass(frozen=True, slots=True, eq=False)
class MappedColumn:
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
