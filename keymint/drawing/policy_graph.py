"""The graph of a policy: every subject that it names, the objects of its rules, and what it decides about them."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Origin
from comarmor.patterns import glob
from comarmor.rules import PERMISSIONS
from comarmor.text import did_you_mean
from keymint.api import LoadedPolicy, PolicyDecision
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.errors import KeymintError
from keymint.graph import LABELLED, Edge, Graph, Object, complete
from keymint.ir import Rule

MOST_EDGES = 250_000
"""Edges that are kept to be drawn: about 250 MB."""


def unchanged(file: str) -> str:
    """Return a path as it is."""
    return file


def nowhere(_where: Origin) -> bool:
    """Tell that no rule is a common one."""
    return False


def label_graph(
    title: str,
    policy: LoadedPolicy,
    graph: Graph,
    subjects: Collection[str],
    *,
    everything: bool = False,
    typed: Callable[[str], str] = unchanged,
    common: Callable[[Origin], bool] = nowhere,
) -> LabelledGraph:
    """Return a graph, or its completion, labelled by a policy.

    Args:
        title: one line.
        policy: the policy.
        graph: the graph, e.g. of a running system.
        subjects: which of its subjects; the objects are those of all.
        everything: label the completion: every subject with every permission on every object.
        typed: returns a path as the user would type it.
        common: tells of the place of a rule whether it is one that every node includes.

    Raises:
        KeymintError: the completion is too large to be drawn; also as :meth:`keymint.api.LoadedPolicy.decide`.
    """
    if everything:
        _refuse_large(len(subjects) * sum(len(LABELLED[found.kind]) for _, found in graph.objects))
    edges = complete(replace(graph, subjects=tuple(subjects))) if everything else graph.edges
    said = _Labels(typed, common)
    labelled = (said.labelled(edge, policy.decide(edge)) for edge in edges if edge.subject in subjects)
    return LabelledGraph.of(title, labelled, subjects)


def policy_graph(
    title: str,
    policy: LoadedPolicy,
    subjects: Sequence[str] = (),
    *,
    everything: bool = False,
    typed: Callable[[str], str] = unchanged,
    common: Callable[[Origin], bool] = nowhere,
) -> LabelledGraph:
    """Return the graph of a policy.

    Its objects are the names in the rules of its subjects. An expression that is no name stands for itself: only the
    subjects whose rules have it are joined to it, by what is decided about a name that hardly anything else matches.

    Args:
        title: one line.
        policy: the policy.
        subjects: which subjects; empty for all that it names exactly.
        everything: also draw what is denied because no rule matches.
        typed: returns a path as the user would type it.
        common: tells of the place of a rule whether it is one that every node includes.

    Raises:
        KeymintError: the policy names no subject exactly, no profile applies to one of these, or the graph is too
            large to be drawn.
    """
    chosen = tuple(subjects) or policy.subjects()
    if not chosen:
        raise KeymintError(
            "the policy names no subject exactly",
            help="name subjects with --subject, e.g. --subject /robot1/camera",
            code="subjects-none",
        )
    names: set[Object] = set()
    expressions: dict[Object, Object] = {}
    own: dict[str, dict[Object, set[str]]] = {}
    for subject in chosen:
        rules = policy.rules(subject)
        if rules is None:
            hint = did_you_mean(subject, policy.subjects(), "attach a profile to it")
            raise KeymintError(f"no profile of the policy applies to {subject}", help=hint, code="subject-unknown")
        mine = own.setdefault(subject, {})
        for rule in rules.rules:
            for found in _objects(rule):
                if _literal(found):
                    names.add(_witness(found))
                else:
                    expressions[found] = _witness(found)
                    mine.setdefault(found, set()).update(rule.permissions)
    if everything:
        _refuse_large(len(chosen) * sum(len(LABELLED[found.kind]) for found in names))
    said = _Labels(typed, common)
    decided = itertools.chain(
        _decided(policy, chosen, sorted(names), said, everything=everything),
        _expressed(policy, own, expressions, said),
    )
    edges = list(itertools.islice(decided, MOST_EDGES + 1))
    _refuse_large(len(edges))
    return LabelledGraph.of(title, edges, chosen, patterns=expressions)


def _refuse_large(edges: int) -> None:
    if edges > MOST_EDGES:
        raise KeymintError(
            f"the graph has more than {MOST_EDGES} edges, which no picture shows",
            help="choose some of it with --subject or --namespace, or leave out --all",
            code="graph-large",
        )


def _decided(
    policy: LoadedPolicy, subjects: Sequence[str], objects: Sequence[Object], said: _Labels, *, everything: bool
) -> Iterator[LabelledEdge]:
    for subject in subjects:
        for found in objects:
            for permission in PERMISSIONS[found.kind]:
                edge = Edge(subject, permission, found)
                decision = policy.decide(edge)
                wanted = everything and permission in LABELLED[found.kind]
                if decision.allowed or decision.where is not None or wanted:
                    yield said.labelled(edge, decision)


def _expressed(
    policy: LoadedPolicy,
    own: Mapping[str, Mapping[Object, set[str]]],
    expressions: Mapping[Object, Object],
    said: _Labels,
) -> Iterator[LabelledEdge]:
    for subject, found in own.items():
        for expression, permissions in found.items():
            for permission in sorted(permissions):
                asked = Edge(subject, permission, expressions[expression])
                yield said.labelled(replace(asked, object=expression), policy.decide(asked))


class _Labels:
    """Makes labels of decisions; the many that are alike are one object."""

    def __init__(self, typed: Callable[[str], str], common: Callable[[Origin], bool]) -> None:
        self._typed = functools.cache(typed)
        self._common = common
        self._known: dict[PolicyDecision, Label] = {}

    def labelled(self, edge: Edge, decision: PolicyDecision) -> LabelledEdge:
        """Return a labelled edge."""
        if decision not in self._known:
            # The place of the rule is said beside the reason.
            reason = decision.reason.replace(f" at {decision.where}", "") if decision.where else decision.reason
            where = self._place(decision.where) if decision.where else None
            self._known[decision] = Label(decision.allowed, reason, where)
        common = decision.allowed and decision.where is not None and self._common(decision.where)
        return LabelledEdge(edge, self._known[decision], (), decision.audit, common)

    def _place(self, origin: Origin) -> Origin:
        return replace(origin, file=self._typed(origin.file), chain=tuple(map(self._place, origin.chain)))


def _objects(rule: Rule) -> Iterator[Object]:
    for expression in rule.expressions:
        yield Object(rule.kind, expression, tuple(sorted(rule.partitions)))


def _literal(found: Object) -> bool:
    return all(isinstance(token, str) for text in (found.name, *found.partitions) for token in glob.parse(text))


def _witness(found: Object) -> Object:
    """Return an object that matches an object of expressions, and hardly any other expression."""
    return Object(found.kind, _member(found.name), tuple(sorted(map(_member, found.partitions))))


def _member(expression: str) -> str:
    """Return a text that an expression matches; a literal's own (``\\`` escapes taken off)."""
    found = []
    for token in glob.parse(expression):
        if isinstance(token, str):
            found.append(token)
        elif isinstance(token, glob.Star):
            found.append("any__name")
        else:
            found.append("x" if "x" in token else next(token.chars()))
    return "".join(found)
