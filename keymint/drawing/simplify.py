# SPDX-License-Identifier: Apache-2.0
"""Options for drawing a graph, and its reduction to what a picture has room for.

Common rules become a mark, subjects of a namespace become a group, and objects with the same edges become one. Then
edges are left out, but never false positives or what a rule denies explicitly.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from itertools import islice

from comarmor.text import one_line, quantity
from comarmor.values import dataclass
from keymint.api.graph import DomainObject, EdgeOutcome
from keymint.drawing.appearance import KINDS, Theme
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph, namespace

FOLD_FROM = 40
"""Objects from which on a graph's objects are folded by default."""
GROUP_FROM = 30
"""Subjects beyond which a graph's subjects are grouped by default, and the most groups if names have enough levels."""


class Split(StrEnum):
    """How a picture is split into panels."""

    NONE = "none"
    SUBJECT = "subject"
    NAMESPACE = "namespace"


@dataclass(frozen=True, slots=True)
class DrawingOptions:
    """Options for drawing a graph.

    Attributes:
        theme: colours.
        split: one panel, or one per subject or namespace of subjects.
        transport: index of the transport whose labels are drawn; None for all together.
        limit: the maximum number of edges; see :func:`shown_edges`.
        fold: draw objects with the same edges as one; None does so in large graphs only.
        group: draw the subjects of a namespace as one; None does so in large graphs only.
        common: draw the edges of common rules; False puts a mark at the subject instead.
    """

    theme: Theme = Theme.AUTO
    split: Split = Split.NONE
    transport: int | None = None
    limit: int = 600
    fold: bool | None = None
    group: bool | None = None
    common: bool = False


@dataclass(frozen=True, slots=True)
class SimplifiedGraph:
    """The part of a graph that is drawn.

    Attributes:
        labelled: the graph.
        options: drawing options.
        edges: the lines, sorted.
        groups: the subjects of each group by its name; a subject that is not grouped is its own group.
        marks: the common edges that are not drawn, by group of their subject.
        members: the objects of each drawn object.
        left_out: number of lines without room.
    """

    labelled: LabelledGraph
    options: DrawingOptions
    edges: tuple[LabelledEdge, ...]
    groups: Mapping[str, tuple[str, ...]]
    marks: Mapping[str, Sequence[LabelledEdge]]
    members: Mapping[DomainObject, tuple[DomainObject, ...]]
    left_out: int


def simplify(labelled: LabelledGraph, options: DrawingOptions) -> SimplifiedGraph:
    """Return the part of a graph that is drawn."""
    # A mark stands for an edge that a common rule allows, if the transport allows it, too.
    marked: dict[LabelledEdge, None] = {}
    if not options.common:
        common = (one for one in labelled.edges if one.common)
        marked = dict.fromkeys(one for one in common if one.outcome(options.transport) is EdgeOutcome.ALLOW)
    edges: Sequence[LabelledEdge] = [one for one in labelled.edges if one not in marked]
    is_large = options.split is Split.NONE and len(labelled.subjects) > GROUP_FROM
    by_namespace = _groups(labelled.subjects) if options.group or (options.group is None and is_large) else {}
    groups = by_namespace if len(by_namespace) > 1 else {subject: (subject,) for subject in labelled.subjects}
    group_of = {subject: name for name, subjects in groups.items() for subject in subjects}
    if groups is by_namespace:
        edges = _group_edges(edges, group_of)
    members: Mapping[DomainObject, tuple[DomainObject, ...]] = {
        key: (key,) for key in {one.edge.domain_object for one in edges}
    }
    if options.fold or (options.fold is None and len(members) >= FOLD_FROM):
        edges, members = _fold(edges)
    shown = shown_edges(edges, options)
    marks: dict[str, list[LabelledEdge]] = defaultdict(list)
    for one in marked:
        marks[group_of[one.edge.subject]].append(one)
    return SimplifiedGraph(labelled, options, shown, groups, marks, members, len(edges) - len(shown))


# -- groups of subjects ----------------------------------------------------------------------------------------------


def _groups(subjects: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
    """Return the subjects of each group by the group's label; a subject alone in its namespace keeps its name.

    The groups are the namespaces of the deepest level that has at most :data:`GROUP_FROM` of them.

    Args:
        subjects: names, sorted.
    """
    deepest = max((namespace(subject).count("/") for subject in subjects), default=1)
    groups: dict[str, list[str]] = {}
    for depth in range(deepest, 0, -1):
        groups = defaultdict(list)
        for subject in subjects:
            levels = namespace(subject).split("/")[:depth]  # "/" alone is one level
            groups["/".join([*levels, ""])].append(subject)
        if len(groups) <= GROUP_FROM:
            break
    return {
        members[0] if len(members) == 1 else f"{prefix}… ({quantity(len(members), 'subject')})": tuple(members)
        for prefix, members in groups.items()
    }


def _group_edges(edges: Sequence[LabelledEdge], group_of: Mapping[str, str]) -> tuple[LabelledEdge, ...]:
    """Return the edges of groups: one for all members that have it with the same labels."""
    grouped: dict[tuple[object, ...], LabelledEdge] = {}
    for one in edges:
        edge = replace(one.edge, subject=group_of[one.edge.subject])
        grouped.setdefault((edge, one.decisions, one.audit), replace(one, edge=edge))
    return tuple(sorted(grouped.values(), key=lambda one: one.edge))


# -- folded objects --------------------------------------------------------------------------------------------------


def _fold(
    edges: Sequence[LabelledEdge],
) -> tuple[tuple[LabelledEdge, ...], dict[DomainObject, tuple[DomainObject, ...]]]:
    """Fold objects of one kind and namespace whose edges have the same subjects, permissions and labels.

    Returns:
        The edges of the first object of each fold, by name, and the objects of each fold.
    """
    signatures: dict[DomainObject, set[object]] = defaultdict(set)
    for one in edges:
        signatures[one.edge.domain_object].add((one.edge.subject, one.edge.permission, one.audit, one.decisions))
    folds: dict[object, list[DomainObject]] = defaultdict(list)
    for (domain, object_), signature in signatures.items():
        place = (domain, object_.kind, namespace(object_.name), object_.partitions)
        folds[(*place, frozenset(signature))].append((domain, object_))
    members = {min(fold): tuple(sorted(fold)) for fold in folds.values()}
    return tuple(one for one in edges if one.edge.domain_object in members), members


def folded_name(members: Sequence[DomainObject]) -> str:
    """Return the label of folded objects: ``/talker/… (6 services)``."""
    first = members[0][1]
    noun = KINDS[first.kind]
    return one_line(f"{namespace(first.name)}… ({len(members)} {noun}{'' if noun.endswith('s') else 's'})")


# -- left out edges --------------------------------------------------------------------------------------------------

EXPLICIT = 1
"""Priority of explicit denials; edges up to this priority are never left out."""
_DEFAULT_DENIAL = 3


def priority(one: LabelledEdge, transport: int | None = None) -> int:
    """Return the priority of an edge, most important first: false labels, explicit denials, others, default denials."""
    outcome = one.outcome(transport)
    if outcome.false:
        return 0
    if outcome is not EdgeOutcome.DENY:
        return 2
    return EXPLICIT if one.policy is not None and one.policy.where is not None else _DEFAULT_DENIAL


def shown_edges(edges: Sequence[LabelledEdge], options: DrawingOptions) -> tuple[LabelledEdge, ...]:
    """Return the edges that a picture has room for, in the same order.

    Beyond the limit all default denials are left out first: showing only some would suggest that the others are
    allowed. Next are allowed edges. False labels and explicit denials stay, however many there are.
    """
    if len(edges) <= options.limit:
        return tuple(edges)
    priorities = {one: priority(one, options.transport) for one in edges}
    kept = {one for one in edges if priorities[one] <= EXPLICIT}
    others = (one for one in edges if EXPLICIT < priorities[one] < _DEFAULT_DENIAL)
    kept.update(islice(others, max(0, options.limit - len(kept))))
    return tuple(one for one in edges if one in kept)
