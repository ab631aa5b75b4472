# SPDX-License-Identifier: Apache-2.0
"""Make the graph of a policy: the subjects that it names, the objects of its rules, and its decisions."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Origin
from comarmor.patterns import glob
from comarmor.patterns.tokens import Star
from comarmor.rules import PERMISSIONS
from comarmor.text import did_you_mean
from keymint.api import LoadedPolicy, PolicyDecision
from keymint.api.graph import LABELLED, Edge, Graph, Object, complete
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.errors import KeymintError
from keymint.names import no_subject

MOST_EDGES = 250_000
"""Maximum number of edges to draw: about 250 MB."""


def label_graph(
    title: str,
    policy: LoadedPolicy,
    graph: Graph,
    subjects: Collection[str],
    *,
    everything: bool = False,
    typed: Callable[[str], str] = str,
    common: Callable[[Origin], bool] = lambda _: False,
) -> LabelledGraph:
    """Return a graph, or its completion, with the labels of a policy.

    Args:
        title: one line.
        policy: the policy.
        graph: the graph, e.g. of a running system.
        subjects: the subjects to keep; all objects are kept.
        everything: label the completion: every subject with every permission on every object.
        typed: returns a path as the user would type it.
        common: returns True for the origin of a rule that every node includes.

    Raises:
        KeymintError: the completion is too large to be drawn, or see :meth:`keymint.api.LoadedPolicy.decide`.
    """
    if everything:
        _refuse_large(len(subjects) * sum(len(LABELLED[object_.kind]) for _, object_ in graph.objects))
    edges = complete(replace(graph, subjects=tuple(subjects))) if everything else graph.edges
    decided = ((edge, policy.decide(edge)) for edge in edges if edge.subject in subjects)
    return LabelledGraph.of(title, _labelled(decided, typed, common), subjects)


def policy_graph(
    title: str,
    policy: LoadedPolicy,
    subjects: Sequence[str] = (),
    *,
    everything: bool = False,
    typed: Callable[[str], str] = str,
    common: Callable[[Origin], bool] = lambda _: False,
) -> LabelledGraph:
    """Return the graph of a policy.

    Its objects are the names in the rules of its subjects. An expression with wildcards is an object of its own: it has
    edges only to subjects with that expression in a rule, labelled by the decision on an unusual name that it matches.

    Args:
        title: one line.
        policy: the policy.
        subjects: the subjects to draw; empty for all that it names exactly.
        everything: also draw denials without a matching rule.
        typed: returns a path as the user would type it.
        common: returns True for the origin of a rule that every node includes.

    Raises:
        KeymintError: the policy names no subject exactly, no profile applies to a subject, or the graph is too large to
            be drawn.
    """
    chosen = tuple(subjects) or policy.subjects()
    if not chosen:
        raise no_subject("select subjects with --subject, e.g. --subject /robot1/camera")
    names: set[Object] = set()
    expressions: dict[Object, Object] = {}
    own: dict[str, dict[Object, set[str]]] = {}
    for subject in chosen:
        rules = policy.rules(subject)
        if rules is None:
            hint = did_you_mean(subject, policy.subjects(), "attach a profile to it")
            raise KeymintError(f"no profile of the policy applies to {subject}", help=hint, code="subject-unknown")
        permissions = own.setdefault(subject, {})
        for rule in rules.rules:
            partitions = tuple(sorted(rule.partitions))
            for object_ in (Object(rule.kind, expression, partitions) for expression in rule.expressions):
                if _literal(object_):
                    names.add(_witness(object_))
                else:
                    expressions[object_] = _witness(object_)
                    permissions.setdefault(object_, set()).update(rule.permissions)
    if everything:
        _refuse_large(len(chosen) * sum(len(LABELLED[object_.kind]) for object_ in names))
    decided = itertools.chain(
        _edges_to_names(policy, chosen, sorted(names), everything=everything),
        _edges_to_expressions(policy, own, expressions),
    )
    edges = list(_labelled(itertools.islice(decided, MOST_EDGES + 1), typed, common))
    _refuse_large(len(edges))
    return LabelledGraph.of(title, edges, chosen, patterns=expressions)


def _refuse_large(edges: int) -> None:
    if edges > MOST_EDGES:
        raise KeymintError(
            f"the graph has more than {MOST_EDGES} edges, too many to draw",
            help="select a part with --subject or --namespace, or omit --all",
            code="graph-large",
        )


def _edges_to_names(
    policy: LoadedPolicy, subjects: Sequence[str], objects: Sequence[Object], *, everything: bool
) -> Iterator[tuple[Edge, PolicyDecision]]:
    for subject in subjects:
        for object_ in objects:
            for permission in PERMISSIONS[object_.kind]:
                edge = Edge(subject, permission, object_)
                decision = policy.decide(edge)
                completes = everything and permission in LABELLED[object_.kind]
                if decision.allowed or decision.where is not None or completes:
                    yield edge, decision


def _edges_to_expressions(
    policy: LoadedPolicy, own: Mapping[str, Mapping[Object, set[str]]], expressions: Mapping[Object, Object]
) -> Iterator[tuple[Edge, PolicyDecision]]:
    for subject, objects in own.items():
        for expression, permissions in objects.items():
            for permission in sorted(permissions):
                edge = Edge(subject, permission, expressions[expression])
                yield replace(edge, object=expression), policy.decide(edge)


def _labelled(
    decided: Iterable[tuple[Edge, PolicyDecision]], typed: Callable[[str], str], common: Callable[[Origin], bool]
) -> Iterator[LabelledEdge]:
    typed = functools.cache(typed)
    labels: dict[PolicyDecision, Label] = {}  # one object for all equal labels saves memory
    for edge, decision in decided:
        if decision not in labels:
            labels[decision] = policy_label(decision, typed)
        shared = decision.allowed and decision.where is not None and common(decision.where)
        yield LabelledEdge(edge, labels[decision], (), decision.audit, shared)


def policy_label(decision: PolicyDecision, typed: Callable[[str], str]) -> Label:
    """Return a decision of a policy as a label, with files as the user would type them."""
    where = decision.where.with_files(typed) if decision.where else None
    # The origin of the rule is shown beside the reason.
    return Label(decision.allowed, decision.reason.without_places(), where)


def _literal(object_: Object) -> bool:
    return all(isinstance(token, str) for text in (object_.name, *object_.partitions) for token in glob.parse(text))


def _witness(expression: Object) -> Object:
    """Return an object that an object with expressions matches, and that hardly any other expression matches."""
    return Object(expression.kind, _member(expression.name), tuple(sorted(map(_member, expression.partitions))))


def _member(expression: str) -> str:
    """Return a text that an expression matches; for a literal itself, without ``\\`` escapes."""
    parts = []
    for token in glob.parse(expression):
        if isinstance(token, str):
            parts.append(token)
        elif isinstance(token, Star):
            parts.append("any__name")
        else:
            parts.append("x" if "x" in token else next(token.chars()))
    return "".join(parts)
