# SPDX-License-Identifier: Apache-2.0
"""Semantic access graphs: subjects, objects, and the permissions that subjects have, or request, on objects.

The terms are those of White et al. 2018: *G_s* is the graph of what an application does; *G_fc* completes it, every
subject with every permission on every object of the same kind. An edge's label is *true* when the transport decides as
the policy does. Allowing is the positive.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from enum import StrEnum

from comarmor.rules import PERMISSIONS
from comarmor.text import lazy_regex
from comarmor.values import Data
from keymint.errors import Diagnostic


class Object(Data, order=True):
    """A topic, service, action, parameter server, or raw topic of the transport.

    Attributes:
        kind: a key of :data:`comarmor.rules.PERMISSIONS`.
        name: its name; for kind ``topic`` the one on the transport.
        partitions: partitions, sorted; only for kind ``topic``. Empty is the default partition.
    """

    kind: str
    name: str
    partitions: tuple[str, ...] = ()


DomainObject = tuple[int, Object]
"""An object in a domain."""


class Edge(Data, order=True):
    """A subject with a permission on an object, in a domain."""

    subject: str
    permission: str
    object: Object
    domain: int = 0

    @property
    def domain_object(self) -> DomainObject:
        """The domain and the object."""
        return self.domain, self.object


class Graph(Data):
    """A semantic access graph.

    Attributes:
        subjects: names, sorted; also of those without an edge.
        edges: sorted, without duplicates.
        types: names of types by object, where they are known.
    """

    subjects: tuple[str, ...]
    edges: tuple[Edge, ...]
    types: tuple[tuple[Object, str], ...] = ()

    @classmethod
    def of(cls, edges: Iterable[Edge], subjects: Iterable[str] = (), types: Iterable[tuple[Object, str]] = ()) -> Graph:
        """Return the graph of these edges; ``subjects`` need only name those without an edge."""
        ordered = tuple(sorted(set(edges)))
        names = {*subjects, *(edge.subject for edge in ordered)}
        return cls(tuple(sorted(names)), ordered, tuple(sorted(set(types))))

    @property
    def objects(self) -> tuple[DomainObject, ...]:
        """Domain and object of all edges, sorted."""
        return tuple(sorted({edge.domain_object for edge in self.edges}))


class Column(Data, eq=False):
    """Requests to ask of several subjects; what follows from a column can be kept for it.

    Attributes:
        requests: the requests as edges, whose subjects do not matter.
    """

    requests: tuple[Edge, ...]


LABELLED: dict[str, tuple[str, ...]] = {
    kind: tuple(permission for permission in permissions if not permission.endswith("relay"))
    for kind, permissions in PERMISSIONS.items()
}
"""Permissions in a completion, by kind. Relaying is left out: no transport decides it."""


def complete(graph: Graph) -> Iterator[Edge]:
    """Yield the edges of the completion of a graph, sorted and one at a time, as there may be very many."""
    requests = column(graph).requests
    for subject in graph.subjects:
        for each in requests:
            yield Edge(subject, each.permission, each.object, each.domain)


def column(graph: Graph) -> Column:
    """Return the requests of each subject in the completion of a graph."""
    return Column(
        tuple(
            Edge("", permission, object_, domain)
            for domain, object_ in graph.objects
            for permission in LABELLED[object_.kind]
        )
    )


class EdgeOutcome(StrEnum):
    """The decision on an edge, compared with the policy.

    ``allow`` is a true positive and ``deny`` a true negative, or the decision of the policy or a transport alone.
    """

    UNLABELLED = "unlabelled"
    ALLOW = "allow"
    DENY = "deny"
    FALSE_POSITIVE = "false-positive"
    FALSE_NEGATIVE = "false-negative"

    @property
    def false(self) -> bool:
        """Whether policy and transport decide differently."""
        return self in MISMATCHES

    @property
    def allowed(self) -> bool:
        """Whether the transport, or else the policy, allows the edge."""
        return self in {EdgeOutcome.ALLOW, EdgeOutcome.FALSE_POSITIVE}


MISMATCHES = frozenset({EdgeOutcome.FALSE_POSITIVE, EdgeOutcome.FALSE_NEGATIVE})


class ConfusionMatrix(Data):
    """Number of edges by outcome of the comparison of a transport with the policy."""

    true_positive: int = 0
    false_negative: int = 0
    false_positive: int = 0
    true_negative: int = 0

    @property
    def edges(self) -> int:
        """Number of all edges."""
        return self.true_positive + self.true_negative + self.errors

    @property
    def errors(self) -> int:
        """Number of edges on which policy and transport differ."""
        return self.false_positive + self.false_negative


# -- names of nodes that have a part which is made at run time, and names that may have one ----------------------------

NAMES_DIFFER = "names-differ"
"""Code of a note on names that two records have in different forms."""
GENERATED = (
    ("transform_listener_impl_", "[0-9a-f]+", "the address of a listener of tf2_ros"),
    ("_ros2cli_daemon_[0-9]+_", "[0-9a-f]+", "a number of the daemon of 'ros2'"),
    ("_ros2cli_", "[0-9]+", "the process id of a command 'ros2'"),
    ("launch_ros_", "[0-9]+", "the process id of 'ros2 launch'"),
    ("moveit_", "[0-9]+", "a number of MoveIt"),
)
"""Known names of nodes: the expression of what stays, that of what changes with each start, and what the latter is.

tf2_ros, ``transform_listener.cpp``; ros2cli, ``node/direct.py`` and ``daemon``; launch_ros, ``ros_adapters.py``. Names
that follow from others, like ``controller_server_rclcpp_node`` of Nav2, are no such names.
"""
_FORMS = "|".join(f"(?P<kept{at}>{kept}){made}" for at, (kept, made, _) in enumerate(GENERATED))
_KNOWN = lazy_regex(f"(?<![^/])(?:{_FORMS})(?=/)")
_MAYBE = lazy_regex(r"(?<=_)(?=[A-Za-z]*[0-9])[A-Za-z0-9]+(?![A-Za-z0-9])|(?<=[A-Za-z])[0-9]+(?=/|\Z)")
"""A part of a name with a digit: between ``_``, or the digits that a segment ends with."""


def general_expression(text: str, kind: str) -> tuple[str, str]:
    """Return an expression of a name in which ``*`` stands for the parts that are made at run time, and what these are.

    Args:
        text: the name, or an expression of it; from the beginning of a segment on.
        kind: kind of the object; parameters have the name of their node.
    """
    whole = kind == "ros_parameter"
    found: list[str] = []

    def kept(match: re.Match[str]) -> str:
        at = next(at for at in range(len(GENERATED)) if match[f"kept{at}"] is not None)
        found.append(GENERATED[at][2])
        return f"{match[f'kept{at}']}*"

    expression = _KNOWN.sub(kept, f"{text}/" if whole else text)
    return expression[:-1] if whole else expression, ", ".join(dict.fromkeys(found))


def is_generated(node: str) -> bool:
    """Tell whether the name of a node has a part that is made at run time."""
    return bool(general_expression(node, "ros_parameter")[1])


def differing_names(one: Graph, other: Graph) -> Iterator[Diagnostic]:
    """Yield a note for names that only one of two records has, where a part with a digit may change at each start.

    Nothing follows from it: ``/arm_1`` and ``/arm_2`` may be two arms.
    """
    before, now = ({_named(edge) for edge in graph.edges} for graph in (one, other))
    gone: dict[tuple[str, ...], str] = {}
    for *rest, name in sorted(before - now):
        gone |= {(*rest, pattern): name for pattern in _patterns(name)}
    told: set[str] = set()
    for *rest, name in sorted(now - before):
        for pattern in _patterns(name):
            earlier = gone.get((*rest, pattern))
            if earlier is not None and pattern not in told:
                told.add(pattern)
                message = f"{earlier} in one record, {name} in another: is a part of this name made at each start?"
                yield Diagnostic.note(NAMES_DIFFER, message, None, f"then write {pattern} in the policy", rest[0])


def _named(edge: Edge) -> tuple[str, str, str, str]:
    return edge.subject, edge.object.kind, edge.permission, general_expression(edge.object.name, edge.object.kind)[0]


def _patterns(name: str) -> Iterator[str]:
    return (f"{name[: part.start()]}*{name[part.end() :]}" for part in _MAYBE.finditer(name))
