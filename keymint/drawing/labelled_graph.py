# SPDX-License-Identifier: Apache-2.0
"""Labelled graphs: the decisions of a policy and of transports on every edge, as data to draw."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NoReturn

from comarmor.errors import Origin
from comarmor.text import did_you_mean, first_few
from comarmor.values import dataclass
from keymint.api.graph import ConfusionMatrix, Edge, EdgeOutcome, Object
from keymint.errors import ExitCode, KeymintError
from keymint.names import typed_subject


@dataclass(frozen=True, slots=True)
class Label:
    """The decision of a policy or transport on an edge.

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
    """An edge with its labels.

    Attributes:
        edge: the edge.
        policy: the policy's label; None without a policy.
        transports: labels of the graph's transports, in their order; None where a transport was not queried.
        audit: the deciding rule asks for monitoring.
        common: the deciding rule belongs to the shipped library and every node includes it.
    """

    edge: Edge
    policy: Label | None = None
    transports: tuple[Label | None, ...] = ()
    audit: bool = False
    common: bool = False

    @property
    def decisions(self) -> tuple[bool | None, ...]:
        """The decision of the policy, then of each transport."""
        return tuple(None if label is None else label.allowed for label in (self.policy, *self.transports))

    def outcome(self, transport: int | None = None) -> EdgeOutcome:
        """Return the outcome for one transport, or for all together (None), where any mismatch wins."""
        labels = self.transports if transport is None else self.transports[transport : transport + 1]
        decisions = [label.allowed for label in labels if label is not None]
        if self.policy is None:
            return _plain(all(decisions)) if decisions else EdgeOutcome.UNLABELLED
        if any(allowed != self.policy.allowed for allowed in decisions):
            return EdgeOutcome.FALSE_NEGATIVE if self.policy.allowed else EdgeOutcome.FALSE_POSITIVE
        return _plain(self.policy.allowed)


def _plain(allowed: bool) -> EdgeOutcome:
    return EdgeOutcome.ALLOW if allowed else EdgeOutcome.DENY


@dataclass(frozen=True, slots=True)
class LabelledGraph:
    """A graph with labels.

    Attributes:
        title: one line.
        edges: sorted.
        subjects: names, sorted; also of those without an edge.
        transports: names, in the order of every edge's ``transports``.
        patterns: objects whose name is an expression of the policy rather than a name.
        confusions: one per transport, if more edges were compared than this graph keeps; else empty.
    """

    title: str
    edges: tuple[LabelledEdge, ...]
    subjects: tuple[str, ...]
    transports: tuple[str, ...] = ()
    patterns: frozenset[Object] = frozenset()
    confusions: tuple[ConfusionMatrix, ...] = ()

    @classmethod
    def of(
        cls,
        title: str,
        edges: Iterable[LabelledEdge],
        subjects: Iterable[str] = (),
        transports: Sequence[str] = (),
        patterns: Iterable[Object] = (),
        confusions: Sequence[ConfusionMatrix] = (),
    ) -> LabelledGraph:
        """Return the graph of these edges; ``subjects`` need only name those without an edge."""
        ordered = tuple(sorted(edges, key=lambda labelled: labelled.edge))
        names = {*subjects, *(labelled.edge.subject for labelled in ordered)}
        return cls(title, ordered, tuple(sorted(names)), tuple(transports), frozenset(patterns), tuple(confusions))

    @property
    def counts(self) -> Mapping[EdgeOutcome, int]:
        """Number of edges by outcome."""
        return Counter(labelled.outcome() for labelled in self.edges)

    def confusion(self, transport: int) -> ConfusionMatrix:
        """Return the confusion matrix of a transport, over the edges that both it and the policy labelled."""
        if self.confusions:
            return self.confusions[transport]
        counts = Counter(
            one.outcome(transport) for one in self.edges if one.policy is not None and one.transports[transport]
        )
        return ConfusionMatrix(
            counts[EdgeOutcome.ALLOW],
            counts[EdgeOutcome.FALSE_NEGATIVE],
            counts[EdgeOutcome.FALSE_POSITIVE],
            counts[EdgeOutcome.DENY],
        )


def namespace(name: str) -> str:
    """Return a name without its last segment, with the slash: ``/robot1/`` of ``/robot1/arm``."""
    return name[: name.rfind("/") + 1]


def choose_subjects(
    known: Sequence[str], subjects: Sequence[str] = (), namespaces: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the subjects that a user selected, sorted; all of them without a selection.

    Args:
        known: names of all subjects.
        subjects: selected names.
        namespaces: names at or below which all subjects are selected.

    Raises:
        KeymintError: no subject has such a name, or none is below such a namespace.
    """
    if not (subjects or namespaces):
        return tuple(sorted(known))
    kept = set()
    for name in map(typed_subject, subjects):
        if name not in known:
            _refuse(f"no subject {name!r} in this graph", name, known)
        kept.add(name)
    for name in namespaces:
        prefix = name.rstrip("/")
        below = {one for one in known if one == prefix or one.startswith(f"{prefix}/")}
        if not below:
            _refuse(f"no subject in the namespace {name!r}", name, sorted({*map(namespace, known)}))
        kept |= below
    return tuple(sorted(kept))


def select_edges(
    labelled: LabelledGraph, *, subjects: Collection[str] | None = None, only: Collection[EdgeOutcome] = ()
) -> LabelledGraph:
    """Return a part of a graph.

    Args:
        labelled: the graph.
        subjects: only these subjects; None for all.
        only: only edges with one of these outcomes, and their subjects; empty for all.
    """
    edges = tuple(
        one
        for one in labelled.edges
        if (subjects is None or one.edge.subject in subjects) and (not only or one.outcome() in only)
    )
    kept = {one.edge.subject for one in edges} if only else set(labelled.subjects if subjects is None else subjects)
    return replace(labelled, edges=edges, subjects=tuple(sorted(kept)), confusions=())


def _refuse(message: str, name: str, known: Sequence[str]) -> NoReturn:
    hint = did_you_mean(name, known, f"there are {first_few(known)}" if known else "the graph is empty")
    raise KeymintError(message, help=hint, code="subject-unknown", exit_code=ExitCode.USAGE)
