"""Labelled graphs: what a policy and transports say about every edge, as data to draw.

The terms are those of White et al. 2018: an edge's label is *true* when the transport decides what the policy says;
an edge that the transport allows against the policy is a *false positive* (here: false allow), the reverse a *false
negative* (false deny).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from comarmor.errors import Origin
from comarmor.text import did_you_mean, first_few
from keymint.errors import ExitCode, KeymintError
from keymint.graph import Edge, Graph, Object


class EdgeOutcome(StrEnum):
    """How an edge is drawn."""

    UNLABELLED = "unlabelled"
    ALLOW = "allow"
    DENY = "deny"
    FALSE_ALLOW = "false-allow"
    FALSE_DENY = "false-deny"

    @property
    def false(self) -> bool:
        """Whether a transport decides otherwise than the policy."""
        return self in MISMATCHES

    @property
    def allowed(self) -> bool:
        """Whether the edge works in the end."""
        return self in {EdgeOutcome.ALLOW, EdgeOutcome.FALSE_ALLOW}


MISMATCHES = frozenset({EdgeOutcome.FALSE_ALLOW, EdgeOutcome.FALSE_DENY})


@dataclass(frozen=True, slots=True)
class Label:
    """What one layer says about an edge.

    Attributes:
        allowed: the decision.
        reason: one line: why.
        where: the rule that decided, if there is one; the file as the user would type it.
    """

    allowed: bool
    reason: str = ""
    where: Origin | None = None


@dataclass(frozen=True, slots=True)
class LabelledEdge:
    """An edge and what is said about it.

    Attributes:
        edge: the edge.
        policy: what the policy says; None when there is none.
        transports: what each transport of the graph says, in their order; None where one was not asked.
        audit: the rule that decided is to be watched.
        common: the rule that decided is one of the shipped library's, which every node includes.
    """

    edge: Edge
    policy: Label | None = None
    transports: tuple[Label | None, ...] = ()
    audit: bool = False
    common: bool = False

    def outcome(self, transport: int | None = None) -> EdgeOutcome:
        """Return how the edge is drawn, for one transport or (None) for all together, where any false label wins."""
        said = self.transports if transport is None else self.transports[transport : transport + 1]
        found = [one.allowed for one in said if one is not None]
        if self.policy is None:
            return _plain(all(found)) if found else EdgeOutcome.UNLABELLED
        if any(allowed != self.policy.allowed for allowed in found):
            return EdgeOutcome.FALSE_DENY if self.policy.allowed else EdgeOutcome.FALSE_ALLOW
        return _plain(self.policy.allowed)


def _plain(allowed: bool) -> EdgeOutcome:
    return EdgeOutcome.ALLOW if allowed else EdgeOutcome.DENY


@dataclass(frozen=True, slots=True)
class Confusion:
    """How the labels of one transport compare with those of the policy, in edges.

    Attributes:
        true_allow: true positives.
        false_deny: false negatives.
        false_allow: false positives.
        true_deny: true negatives.
    """

    true_allow: int
    false_deny: int
    false_allow: int
    true_deny: int


@dataclass(frozen=True, slots=True)
class LabelledGraph:
    """A graph with labels.

    Attributes:
        title: one line.
        edges: sorted.
        subjects: names, sorted; also of those without an edge.
        transports: names, in the order of every edge's ``transports``.
        patterns: objects whose name is an expression of the policy rather than a name.
        confusions: one per transport, when more edges were compared than are kept here; else empty.
    """

    title: str
    edges: tuple[LabelledEdge, ...]
    subjects: tuple[str, ...]
    transports: tuple[str, ...] = ()
    patterns: frozenset[Object] = frozenset()
    confusions: tuple[Confusion, ...] = ()

    @classmethod
    def of(
        cls,
        title: str,
        edges: Iterable[LabelledEdge],
        subjects: Iterable[str] = (),
        transports: Sequence[str] = (),
        patterns: Iterable[Object] = (),
        confusions: Sequence[Confusion] = (),
    ) -> LabelledGraph:
        """Return the graph of these edges; subjects of the edges need not be named again."""
        found = tuple(sorted(edges, key=lambda labelled: labelled.edge))
        named = {*subjects, *(labelled.edge.subject for labelled in found)}
        return cls(title, found, tuple(sorted(named)), tuple(transports), frozenset(patterns), tuple(confusions))

    @classmethod
    def of_graph(cls, title: str, graph: Graph) -> LabelledGraph:
        """Return a graph about which nothing is said."""
        return cls.of(title, (LabelledEdge(edge) for edge in graph.edges), graph.subjects)

    @property
    def counts(self) -> Mapping[EdgeOutcome, int]:
        """Number of edges by outcome."""
        return Counter(labelled.outcome() for labelled in self.edges)

    def confusion(self, transport: int) -> Confusion:
        """Return how a transport compares with the policy over the edges that both were asked about."""
        if self.confusions:
            return self.confusions[transport]
        asked = Counter(
            one.outcome(transport) for one in self.edges if one.policy is not None and one.transports[transport]
        )
        return Confusion(
            asked[EdgeOutcome.ALLOW],
            asked[EdgeOutcome.FALSE_DENY],
            asked[EdgeOutcome.FALSE_ALLOW],
            asked[EdgeOutcome.DENY],
        )


def namespace(name: str) -> str:
    """Return what stands before the last segment of a name, with the slash: ``/robot1/`` of ``/robot1/arm``."""
    return name[: name.rfind("/") + 1]


def choose_subjects(
    known: Sequence[str], subjects: Sequence[str] = (), namespaces: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the subjects that a user asked for, sorted; all of them when nothing was asked for.

    Args:
        known: names of all subjects.
        subjects: names of some.
        namespaces: names at or below which subjects lie.

    Raises:
        KeymintError: no subject has such a name, or none lies there.
    """
    if not (subjects or namespaces):
        return tuple(sorted(known))
    kept = set()
    for name in subjects:
        if name not in known:
            _refuse(f"no subject {name!r} in this graph", name, known)
        kept.add(name)
    for name in namespaces:
        prefix = name.rstrip("/")
        below = {one for one in known if one == prefix or one.startswith(f"{prefix}/")}
        if not below:
            _refuse(f"no subject lies in the namespace {name!r}", name, sorted({*map(namespace, known)}))
        kept |= below
    return tuple(sorted(kept))


def select_edges(
    labelled: LabelledGraph, *, subjects: Collection[str] | None = None, only: Collection[EdgeOutcome] = ()
) -> LabelledGraph:
    """Return a part of a graph.

    Args:
        labelled: the graph.
        subjects: only these subjects; None for all.
        only: only edges with one of these outcomes, and subjects that have such; empty for all. What differs from the
            policy is ``only=DIFFERENCES``.
    """
    edges = tuple(
        one
        for one in labelled.edges
        if (subjects is None or one.edge.subject in subjects) and (not only or one.outcome() in only)
    )
    kept = {one.edge.subject for one in edges} if only else set(labelled.subjects if subjects is None else subjects)
    return replace(labelled, edges=edges, subjects=tuple(sorted(kept)), confusions=())


def _refuse(message: str, name: str, known: Sequence[str]) -> None:
    hint = did_you_mean(name, known, f"there are {first_few(known, 5)}" if known else "the graph is empty")
    raise KeymintError(message, help=hint, code="subject-unknown", exit_code=ExitCode.USAGE)
