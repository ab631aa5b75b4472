"""Semantic access graphs: subjects, objects, and the permissions that subjects have, or want, on objects.

The terms are those of White et al. 2018: *G_s* is the graph of what an application does; *G_fc* completes it, every
subject with every permission on every object of the same kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from comarmor.rules import PERMISSIONS


@dataclass(frozen=True, slots=True, order=True)
class Object:
    """What permissions are about.

    Attributes:
        kind: a key of :data:`comarmor.rules.PERMISSIONS`.
        name: its name; for kind ``topic`` the DDS topic's.
        partitions: DDS partitions, sorted; only for kind ``topic``. Empty is the default partition.
    """

    kind: str
    name: str
    partitions: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, order=True)
class Edge:
    """A subject with a permission on an object, in a DDS domain."""

    subject: str
    permission: str
    object: Object
    domain: int = 0


@dataclass(frozen=True, slots=True)
class Graph:
    """A semantic access graph.

    Attributes:
        subjects: names, sorted; also of those without an edge.
        edges: sorted, without doubles.
        types: names of DDS or ROS types by object, where they are known.
    """

    subjects: tuple[str, ...]
    edges: tuple[Edge, ...]
    types: tuple[tuple[Object, str], ...] = ()

    @classmethod
    def of(cls, edges: Iterable[Edge], subjects: Iterable[str] = (), types: Iterable[tuple[Object, str]] = ()) -> Graph:
        """Return the graph of these edges; subjects of the edges need not be named again."""
        found = tuple(sorted(set(edges)))
        named = {*subjects, *(edge.subject for edge in found)}
        return cls(tuple(sorted(named)), found, tuple(sorted(set(types))))

    @property
    def objects(self) -> tuple[tuple[int, Object], ...]:
        """Every domain and object that an edge is about, sorted."""
        return tuple(sorted({(edge.domain, edge.object) for edge in self.edges}))


LABELLED: dict[str, tuple[str, ...]] = {
    kind: tuple(permission for permission in permissions if not permission.endswith("relay"))
    for kind, permissions in PERMISSIONS.items()
}
"""The permissions that a completion has: relaying is no endpoint's doing, so that no transport decides it."""


def complete(graph: Graph) -> Iterator[Edge]:
    """Yield the edges of the completion of a graph, sorted: nothing is kept, so that it may be large."""
    objects = graph.objects
    for subject in graph.subjects:
        for domain, found in objects:
            for permission in LABELLED[found.kind]:
                yield Edge(subject, permission, found, domain)
