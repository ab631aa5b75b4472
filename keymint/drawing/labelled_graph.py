# SPDX-License-Identifier: Apache-2.0
"""Labelled graphs: the decisions of a policy and of transports on every edge, as data to draw.

:func:`policy_graph` makes the graph of a policy: the subjects that it names, the objects of its rules, and its
decisions.
"""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import NoReturn

from comarmor.patterns import glob
from comarmor.rules import PERMISSIONS
from comarmor.text import did_you_mean, first_few
from comarmor.values import Data, field, replace
from keymint.api import LoadedPolicy, PolicyDecision
from keymint.api.graph import LABELLED, ConfusionMatrix, Edge, EdgeOutcome, Graph, Object, complete
from keymint.errors import ExitCode, KeymintError, Origin
from keymint.names import no_subject, typed_subject


class Label(Data):
    """The decision of a policy or transport on an edge.

    Attributes:
        allowed: the decision.
        reason: one line: why.
        where: the rule that decided, if there is one; the file as the user would type it.
    """

    allowed: bool
    reason: str = ""
    where: Origin | None = None


class LabelledEdge(Data):
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

    @property
    def judged(self) -> tuple[object, ...]:
        """All that a picture shows of an edge but its ends: edges are merged only if it is the same."""
        return self.decisions, self.audit, self.common, self.policy is not None and self.policy.where is not None

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


LeftOut = tuple[EdgeOutcome, str]
"""What an edge that is not drawn is counted by: its outcome, and the kind of its object."""


class LabelledGraph(Data):
    """A graph with labels.

    Attributes:
        title: one line.
        edges: sorted.
        subjects: names, sorted; also of those without an edge.
        transports: names, in the order of every edge's ``transports``.
        patterns: objects whose name is an expression of the policy rather than a name.
        confusions: one per transport, if more edges were compared than this graph keeps; else empty.
        omitted: number of edges that this graph does not keep, by outcome and kind of their object.
        endpoints: how many of all edges are no edges of the graph, but single topics of these that a transport allows.
        probes: objects whose name was made up to probe a pattern.
        unnamed: expressions of subjects that a policy gives rights, but does not name: no edge is theirs.
        made: what it was made of and when, in lines.
    """

    title: str
    edges: tuple[LabelledEdge, ...]
    subjects: tuple[str, ...]
    transports: tuple[str, ...] = ()
    patterns: frozenset[Object] = frozenset()
    confusions: tuple[ConfusionMatrix, ...] = ()
    omitted: Mapping[LeftOut, int] = field(default_factory=dict)
    endpoints: int = 0
    probes: frozenset[Object] = frozenset()
    unnamed: tuple[str, ...] = ()
    made: tuple[str, ...] = ()

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
    def total(self) -> int:
        """Number of all edges, also of those that it does not keep."""
        return len(self.edges) + sum(self.omitted.values())

    @property
    def counts(self) -> Mapping[EdgeOutcome, int]:
        """Number of all edges by outcome."""
        counts = Counter(labelled.outcome() for labelled in self.edges)
        for (outcome, _), count in self.omitted.items():
            counts[outcome] += count
        return counts

    def left_out(self, kept: Iterable[LabelledEdge], transport: int | None = None) -> Mapping[LeftOut, int]:
        """Return how many edges are not among these, by outcome and kind; also those that this graph does not keep."""
        gone = {*self.edges}.difference(kept)
        counts = Counter((one.outcome(transport), one.edge.object.kind) for one in gone)
        return counts + Counter(self.omitted)

    def confusion(self, transport: int) -> ConfusionMatrix:
        """Return the confusion matrix of a transport, over the edges that both it and the policy labelled."""
        if self.confusions:
            return self.confusions[transport]
        counts = Counter(
            one.outcome(transport) for one in self.edges if one.policy is not None and one.transports[transport]
        )
        allowed, denied = EdgeOutcome.ALLOW, EdgeOutcome.DENY
        wrong = (counts[EdgeOutcome.FALSE_NEGATIVE], counts[EdgeOutcome.FALSE_POSITIVE])
        return ConfusionMatrix(counts[allowed], *wrong, counts[denied])


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
    return replace(labelled, edges=edges, subjects=tuple(sorted(kept)), confusions=(), omitted={}, endpoints=0)


def _refuse(message: str, name: str, known: Sequence[str]) -> NoReturn:
    hint = did_you_mean(name, known, f"there are {first_few(known)}" if known else "the graph is empty")
    raise KeymintError(message, help=hint, code="subject-unknown", exit_code=ExitCode.USAGE)


MOST_EDGES = 250_000
"""Maximum number of edges to draw: about 250 MB."""


class DrawnPolicy(Data):
    """A policy to draw, or to label a graph by.

    Attributes:
        loaded: the policy.
        name: what a title calls it.
        typed: returns a path as the user would type it.
        common: returns True for the origin of a rule that every node includes.
    """

    loaded: LoadedPolicy
    name: str
    typed: Callable[[str], str] = str
    common: Callable[[Origin], bool] = lambda _: False

    def labelled(self, decided: Iterable[tuple[Edge, PolicyDecision]]) -> Iterator[LabelledEdge]:
        """Yield edges that the policy decided on with its labels."""
        typed = functools.cache(self.typed)
        labels: dict[PolicyDecision, Label] = {}  # one object for all equal labels saves memory
        for edge, decision in decided:
            if decision not in labels:
                labels[decision] = policy_label(decision, typed)
            shared = decision.allowed and decision.where is not None and self.common(decision.where)
            yield LabelledEdge(edge, labels[decision], (), decision.audit, shared)


def label_graph(
    title: str, policy: DrawnPolicy, graph: Graph, subjects: Collection[str], *, everything: bool = False
) -> LabelledGraph:
    """Return a graph, or its completion, with the labels of a policy.

    Args:
        title: one line.
        policy: the policy.
        graph: the graph, e.g. of a running system.
        subjects: the subjects to keep; all objects are kept.
        everything: label the completion: every subject with every permission on every object.

    Raises:
        KeymintError: the completion is too large to be drawn, or see :meth:`keymint.api.LoadedPolicy.decide`.
    """
    if everything:
        _refuse_large(len(subjects) * sum(len(LABELLED[object_.kind]) for _, object_ in graph.objects))
    edges = complete(replace(graph, subjects=tuple(subjects))) if everything else graph.edges
    decided = ((edge, policy.loaded.decide(edge)) for edge in edges if edge.subject in subjects)
    return LabelledGraph.of(title, policy.labelled(decided), subjects)


def policy_graph(
    title: str, policy: DrawnPolicy, subjects: Sequence[str] = (), *, everything: bool = False
) -> LabelledGraph:
    """Return the graph of a policy.

    Its objects are the names in the rules of its subjects. An expression with wildcards is an object of its own: it has
    edges only to subjects with that expression in a rule, labelled by the decision on an unusual name that it matches.

    Args:
        title: one line.
        policy: the policy.
        subjects: the subjects to draw; empty for all that it names exactly.
        everything: also draw denials without a matching rule.

    Raises:
        KeymintError: the policy names no subject exactly, no profile applies to a subject, or the graph is too large to
            be drawn.
    """
    loaded = policy.loaded
    chosen = tuple(subjects) or loaded.subjects()
    if not chosen:
        raise no_subject("select subjects with --subject, e.g. --subject /robot1/camera")
    names: set[Object] = set()
    asked: dict[Edge, Object] = {}  # edges to expressions, each with the object to decide about
    for subject in chosen:
        rules = loaded.rules(subject)
        if rules is None:
            hint = did_you_mean(subject, loaded.subjects(), "attach a profile to it")
            raise KeymintError(f"no profile of the policy applies to {subject}", help=hint, code="subject-unknown")
        for rule in rules.rules:
            partitions = tuple(sorted(rule.partitions))
            for object_ in (Object(rule.kind, expression, partitions) for expression in rule.expressions):
                texts = (object_.name, *partitions)
                if all(isinstance(token, str) for text in texts for token in glob.parse(text)):
                    names.add(_witness(object_))
                else:
                    witness = _witness(object_)
                    asked |= {Edge(subject, permission, object_): witness for permission in rule.permissions}
    if everything:
        _refuse_large(len(chosen) * sum(len(LABELLED[object_.kind]) for object_ in names))
    to_names = _edges_to_names(loaded, itertools.product(chosen, sorted(names)), everything=everything)
    to_expressions = ((edge, loaded.decide(replace(edge, object=witness))) for edge, witness in asked.items())
    decided = itertools.islice(itertools.chain(to_names, to_expressions), MOST_EDGES + 1)
    edges = list(policy.labelled(decided))
    _refuse_large(len(edges))
    graph = LabelledGraph.of(title, edges, chosen, patterns={edge.object for edge in asked})
    return graph if subjects else replace(graph, unnamed=_unnamed(loaded))


def _unnamed(policy: LoadedPolicy) -> tuple[str, ...]:
    structure = policy.structure()
    attachments = (text for each in (structure.profiles if structure else ()) for text, _ in each.attachments)
    return tuple(dict.fromkeys(text for text in attachments if glob.literal(glob.parse(text)) is None))


def _edges_to_names(
    policy: LoadedPolicy, pairs: Iterable[tuple[str, Object]], *, everything: bool
) -> Iterator[tuple[Edge, PolicyDecision]]:
    for subject, object_ in pairs:
        for permission in PERMISSIONS[object_.kind]:
            edge = Edge(subject, permission, object_)
            decision = policy.decide(edge)
            completes = everything and permission in LABELLED[object_.kind]
            if decision.allowed or decision.where is not None or completes:
                yield edge, decision


def _refuse_large(edges: int) -> None:
    if edges > MOST_EDGES:
        message = f"the graph has more than {MOST_EDGES} edges, too many to draw"
        help_ = "select a part with --subject or --namespace, or omit --all"
        raise KeymintError(message, help=help_, code="graph-large")


def policy_label(decision: PolicyDecision, typed: Callable[[str], str]) -> Label:
    """Return a decision of a policy as a label, with files as the user would type them."""
    where = decision.where.with_files(typed) if decision.where else None
    # The origin of the rule is shown beside the reason.
    return Label(decision.allowed, decision.reason.without_places(), where)


def _witness(expression: Object) -> Object:
    """Return an object that an object with expressions matches, and that hardly any other expression matches."""
    return Object(expression.kind, _member(expression.name), tuple(sorted(map(_member, expression.partitions))))


def _member(expression: str) -> str:
    """Return a text that an expression matches; for a literal itself, without ``\\`` escapes."""
    pattern = glob.parse(expression)
    return glob.filled_text(pattern, "any__name", lambda members: "x" if "x" in members else next(members.chars()))
