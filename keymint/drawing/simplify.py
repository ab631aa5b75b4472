# SPDX-License-Identifier: Apache-2.0
"""Options for drawing a graph, and its reduction to what a picture has room for.

One robot is drawn for all that are alike, an action or parameters for the services that they consist of, a mark for
common rules, and one object for those with the same edges. What is still too much for lines becomes matrices. Beyond a
limit edges are left out, never false positives or what a rule denies explicitly, and counted by kind.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from itertools import chain, islice

from comarmor.rules import PARTS
from comarmor.values import Data
from keymint.api.graph import DomainObject, Edge, EdgeOutcome, Object
from keymint.drawing.alike import AlikeFold, fold_alike
from keymint.drawing.appearance import Theme
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph, LeftOut, namespace
from keymint.drawing.layout import NodeKey

FOLD_FROM = 40
"""Objects from which on a graph's objects are folded by default."""
GROUP_FROM = 30
"""Subjects beyond which robots that are alike are drawn once by default, and subjects that remain as matrices."""
MOST_LINES = 600
"""Lines that are legible in one picture; more edges are drawn as matrices."""
MOST_SIGNS = 20_000
"""Edges in matrices, about 300 bytes each."""

_Stands = Mapping[LabelledEdge, Sequence[LabelledEdge]]
"""Edges, each with all edges that it stands for."""
Members = tuple[tuple[NodeKey, ...], ...]
"""A subject, or objects with the same edges that are drawn as one, each with the same one of all robots that are alike.
"""


class Split(StrEnum):
    """How a picture is split into panels."""

    NONE = "none"
    SUBJECT = "subject"
    NAMESPACE = "namespace"


class DrawingOptions(Data):
    """Options for drawing a graph.

    Attributes:
        theme: colours.
        split: one panel, or one per subject or namespace of subjects.
        transport: index of the transport whose labels are drawn; None for all together.
        limit: the maximum number of edges; None draws as many as are legible, see :func:`shown_edges`.
        fold: draw one of the robots that are alike, and objects with the same edges as one; None does so in large
            graphs only.
        group: draw the subjects of a namespace as a matrix; None does so in large graphs only.
        common: draw the edges of common rules; False puts a mark at the subject instead.
        denials: draw denials without a rule also in graphs of more than :data:`MOST_LINES` edges.
    """

    theme: Theme = Theme.AUTO
    split: Split = Split.NONE
    transport: int | None = None
    limit: int | None = None
    fold: bool | None = None
    group: bool | None = None
    common: bool = False
    denials: bool = True


class SimplifiedGraph(Data):
    """The part of a graph that is drawn.

    Attributes:
        labelled: the graph.
        options: drawing options.
        stands: the lines, or signs of a matrix, sorted, each with all edges that it stands for.
        fold: robots of which one is drawn, and the subjects.
        marks: the common edges that are not drawn, by subject, each with all that it stands for.
        members: what each drawn subject and object stands for.
        matrices: whether the edges are drawn as matrices.
        left_out: number of edges that are not drawn, by outcome and kind of their object.
    """

    labelled: LabelledGraph
    options: DrawingOptions
    stands: _Stands
    fold: AlikeFold
    marks: Mapping[NodeKey, _Stands]
    members: Mapping[NodeKey, Members]
    matrices: bool
    left_out: Mapping[LeftOut, int]

    @property
    def folded(self) -> int:
        """Number of edges that have no line of their own, because a line or mark stands for them."""
        return self.labelled.total - len(self.stands) - sum(self.left_out.values())


def simplify(labelled: LabelledGraph, options: DrawingOptions) -> SimplifiedGraph:
    """Return the part of a graph that is drawn. Each edge is drawn, or another stands for it, or it is counted."""
    edges = labelled.edges
    if not options.denials and len(edges) > MOST_LINES:
        edges = tuple(one for one in edges if priority(one, options.transport) < _DEFAULT_DENIAL)
    folded = fold_alike(edges, labelled.subjects, deepest=0)
    stands, marks = _reduced(folded.edges, options)
    single = options.split is Split.NONE
    large = len(stands) > (options.limit or MOST_LINES) or (single and len(labelled.subjects) > GROUP_FROM)
    if options.fold or (options.fold is None and large):
        folded = fold_alike(edges, labelled.subjects)
        stands, marks = _reduced(folded.edges, options)
    copies: dict[DomainObject, dict[DomainObject, None]] = defaultdict(dict)
    for one, those in folded.edges.items():
        copies[one.edge.domain_object].update(dict.fromkeys(each.edge.domain_object for each in those))
    members: dict[NodeKey, Members] = {
        one.edge.domain_object: (tuple(copies[one.edge.domain_object]),) for one in stands
    }
    if options.fold or (options.fold is None and len(members) >= FOLD_FROM):
        stands, members = _fold(stands, members, labelled.patterns | labelled.probes)
    lines = sorted(stands, key=lambda one: one.edge)
    many = options.limit is None and len(lines) > MOST_LINES
    crowded = many or (single and len(folded.subjects) > GROUP_FROM)
    matrices = crowded if options.group is None else options.group
    shown = {one: stands[one] for one in shown_edges(lines, options, matrices=matrices)}
    kept = chain.from_iterable(each.values() for each in (shown, *marks.values()))
    left_out = labelled.left_out(chain.from_iterable(kept), options.transport)
    members |= {name: (names,) for name, names in folded.subjects.items()}
    return SimplifiedGraph(labelled, options, shown, folded, marks, members, matrices, left_out)


def _reduced(stands: _Stands, options: DrawingOptions) -> tuple[_Stands, Mapping[NodeKey, _Stands]]:
    """Return the edges without what others stand for, and by subject the edges that a mark stands for.

    Services and topics of an action or of parameters that a subject may use as a whole are no edges. A mark stands for
    what a common rule allows, if the transport does, too.
    """
    whole_of: dict[tuple[Edge, object], LabelledEdge] = {}
    for one in stands:
        edge = one.edge
        for kind, permission, suffix in PARTS.get((edge.object.kind, edge.permission), ()):
            part = Edge(edge.subject, permission, Object(kind, edge.object.name + suffix), edge.domain)
            whole_of[part, one.judged] = one
    lines: dict[LabelledEdge, list[LabelledEdge]] = defaultdict(list)
    marks: dict[NodeKey, dict[LabelledEdge, list[LabelledEdge]]] = defaultdict(lambda: defaultdict(list))
    for one, those in stands.items():
        whole = whole_of.get((one.edge, one.judged), one)
        common = whole.common and not options.common and whole.outcome(options.transport) is EdgeOutcome.ALLOW
        (marks[one.edge.subject] if common else lines)[whole] += those
    return lines, marks


def _fold(
    stands: _Stands, members: Mapping[NodeKey, Members], unreal: Collection[Object]
) -> tuple[_Stands, dict[NodeKey, Members]]:
    """Fold objects of one kind and namespace whose edges have the same subjects, permissions and labels.

    Returns:
        The edges of the first object of each fold, by name, and the objects of each fold.
    """
    signatures: dict[DomainObject, set[object]] = defaultdict(set)
    for one in stands:
        signatures[one.edge.domain_object].add((one.edge.subject, one.edge.permission, one.judged))
    folds: dict[object, list[DomainObject]] = defaultdict(list)
    for key, signature in signatures.items():
        domain, object_ = key
        place = (domain, object_.kind, namespace(object_.name), object_.partitions)
        folds[place, object_ in unreal, len(members[key][0]), frozenset(signature)].append(key)
    first_of = {key: min(fold) for fold in folds.values() for key in fold}
    alike: dict[object, list[LabelledEdge]] = defaultdict(list)
    for one in stands:
        alike[one.edge.subject, one.edge.permission, first_of[one.edge.domain_object], one.judged].append(one)
    found = {
        min(those, key=lambda one: one.edge): [*chain.from_iterable(stands[one] for one in those)]
        for those in alike.values()
    }
    return found, {min(fold): tuple(members[key][0] for key in sorted(fold)) for fold in folds.values()}


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


def shown_edges(
    edges: Sequence[LabelledEdge], options: DrawingOptions, *, matrices: bool = False
) -> tuple[LabelledEdge, ...]:
    """Return the edges that a picture has room for, in the same order.

    Beyond the limit all default denials are left out first: showing only some would suggest that the others are
    allowed. Next are allowed edges. False labels and explicit denials stay, however many there are.
    """
    limit = options.limit or (MOST_SIGNS if matrices else MOST_LINES)
    if len(edges) <= limit:
        return tuple(edges)
    priorities = {one: priority(one, options.transport) for one in edges}
    kept = {one for one in edges if priorities[one] <= EXPLICIT}
    others = (one for one in edges if EXPLICIT < priorities[one] < _DEFAULT_DENIAL)
    kept.update(islice(others, max(0, limit - len(kept))))
    return tuple(one for one in edges if one in kept)
