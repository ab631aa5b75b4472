"""The graph of a policy: every subject that it names, the objects of its rules, and what it decides about them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from keymint.api import LoadedPolicy, PolicyDecision
from keymint.errors import KeymintError
from keymint.graph import LABELLED, Edge, Graph, Object, complete
from keymint.ir import PERMISSIONS, Rule
from keymint.keymake import glob
from keymint.pictures.model import Labelled, LabelledEdge, Said


def label(policy: LoadedPolicy, edges: Iterable[Edge]) -> Iterator[LabelledEdge]:
    """Yield edges with what a policy says about them; errors as :meth:`keymint.api.LoadedPolicy.decide`."""
    for edge in edges:
        yield _labelled(edge, policy.decide(edge))


def of_graph(title: str, policy: LoadedPolicy, graph: Graph, *, everything: bool) -> Labelled:
    """Return a graph, or its completion, labelled by a policy.

    Args:
        title: one line.
        policy: the policy.
        graph: the graph, e.g. of a running system.
        everything: label the completion: every subject with every permission on every object.
    """
    return Labelled.of(title, label(policy, complete(graph) if everything else graph.edges), graph.subjects)


def of_policy(title: str, policy: LoadedPolicy, subjects: Sequence[str] = (), *, everything: bool = False) -> Labelled:
    """Return the graph of a policy.

    Its objects are the names in the rules of its subjects. An expression that is no name stands for itself: only the
    subjects whose rules have it are joined to it, with what is decided about a name that nothing but the expression
    matches by design.

    Args:
        title: one line.
        policy: the policy.
        subjects: which subjects; empty for all that it names exactly.
        everything: also draw what is denied because no rule matches.

    Raises:
        KeymintError: the policy names no subject exactly, or no profile applies to one of these.
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
            raise KeymintError(f"no profile of the policy applies to {subject}", code="subject-unknown")
        mine = own.setdefault(subject, {})
        for rule in rules.rules:
            for found in _objects(rule):
                witness = _witness(found)
                if witness == found:
                    names.add(found)
                elif _literal(found):
                    names.add(witness)
                else:
                    expressions[found] = witness
                    mine.setdefault(found, set()).update(rule.permissions)
    edges = [
        *_decided(policy, chosen, sorted(names), everything=everything),
        *_expressed(policy, own, expressions),
    ]
    return Labelled.of(title, edges, chosen, patterns=expressions)


def _decided(
    policy: LoadedPolicy, subjects: Sequence[str], objects: Sequence[Object], *, everything: bool
) -> Iterator[LabelledEdge]:
    for subject in subjects:
        for found in objects:
            for permission in PERMISSIONS[found.kind]:
                edge = Edge(subject, permission, found)
                decision = policy.decide(edge)
                wanted = everything and permission in LABELLED[found.kind]
                if decision.allowed or decision.where is not None or wanted:
                    yield _labelled(edge, decision)


def _expressed(
    policy: LoadedPolicy, own: dict[str, dict[Object, set[str]]], expressions: dict[Object, Object]
) -> Iterator[LabelledEdge]:
    for subject, found in own.items():
        for expression, permissions in found.items():
            for permission in sorted(permissions):
                asked = Edge(subject, permission, expressions[expression])
                yield _labelled(replace(asked, object=expression), policy.decide(asked))


def _labelled(edge: Edge, decision: PolicyDecision) -> LabelledEdge:
    return LabelledEdge(edge, Said(decision.allowed, decision.reason, decision.where), (), decision.audit)


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
