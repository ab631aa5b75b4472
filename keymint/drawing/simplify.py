# SPDX-License-Identifier: Apache-2.0
"""Options for drawing a graph, and its reduction to what a picture has room for.

One robot is drawn for all that are alike, an action or parameters for the services that they consist of, a mark for
common rules, and one object for those with the same edges. What is still too much for lines becomes matrices. Beyond a
limit edges are left out, never false positives or what a rule denies explicitly, and counted by kind.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from itertools import islice

from comarmor.rules import PARTS
from comarmor.text import natural_order
from comarmor.values import dataclass
from keymint.api.graph import DomainObject, Edge, EdgeOutcome, Object
from keymint.drawing.alike import Alike, AlikeFold, fold_alike
from keymint.drawing.appearance import Theme
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph, namespace

FOLD_FROM = 40
"""Objects from which on a graph's objects are folded by default."""
GROUP_FROM = 30
"""Subjects beyond which robots that are alike are drawn once by default, and subjects that remain as matrices."""
MOST_LINES = 600
"""Lines that are legible in one picture; more edges are drawn as matrices."""
MOST_SIGNS = 20_000
"""Edges in matrices, about 300 bytes each."""

LeftOut = tuple[EdgeOutcome, str]
"""What an edge that is not drawn is counted by: its outcome, and the kind of its object."""


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


@dataclass(frozen=True, slots=True)
class SimplifiedGraph:
    """The part of a graph that is drawn.

    Attributes:
        labelled: the graph.
        options: drawing options.
        edges: the lines, or signs of a matrix, sorted.
        stands: all edges that each of them stands for.
        subjects: the subjects that are drawn, each with those that it stands for.
        alike: robots of which one is drawn.
        others: objects of another robot than the subjects at their edges.
        marks: the common edges that are not drawn, by subject.
        members: the objects of each drawn object.
        copies: what a drawn object stands for, besides itself the same object of robots that are alike.
        matrices: whether the edges are drawn as matrices.
        left_out: number of edges that are not drawn, by outcome and kind of their object.
    """

    labelled: LabelledGraph
    options: DrawingOptions
    edges: tuple[LabelledEdge, ...]
    stands: Mapping[LabelledEdge, Sequence[LabelledEdge]]
    subjects: Mapping[str, tuple[str, ...]]
    alike: tuple[Alike, ...]
    others: frozenset[DomainObject]
    marks: Mapping[str, Sequence[LabelledEdge]]
    members: Mapping[DomainObject, tuple[DomainObject, ...]]
    copies: Mapping[DomainObject, tuple[DomainObject, ...]]
    matrices: bool
    left_out: Mapping[LeftOut, int]

    @property
    def folded(self) -> int:
        """Number of edges that have no line of their own, because a line or mark stands for them."""
        return self.labelled.total - len(self.edges) - sum(self.left_out.values())


_Stands = dict[LabelledEdge, list[LabelledEdge]]
"""Edges, each with all edges that it stands for."""


def simplify(labelled: LabelledGraph, options: DrawingOptions) -> SimplifiedGraph:
    """Return the part of a graph that is drawn. Each edge is drawn, or another stands for it, or it is counted."""
    edges, left = labelled.edges, list[LabelledEdge]()
    if not options.denials and len(edges) > MOST_LINES:
        left += (one for one in edges if priority(one, options.transport) == _DEFAULT_DENIAL)
        edges = tuple(one for one in edges if priority(one, options.transport) < _DEFAULT_DENIAL)
    folded = AlikeFold({one: [one] for one in edges}, {name: (name,) for name in labelled.subjects}, frozenset(), ())
    stands, marked = _without_marked(_without_parts(folded.edges), options)
    single = options.split is Split.NONE
    large = len(stands) > (options.limit or MOST_LINES) or (single and len(labelled.subjects) > GROUP_FROM)
    if options.fold or (options.fold is None and large):
        folded = fold_alike(edges, labelled.subjects)
        stands, marked = _without_marked(_without_parts(folded.edges), options)
    copies = _copies(folded.edges)
    members: dict[DomainObject, tuple[DomainObject, ...]] = {
        key: (key,) for key in {one.edge.domain_object for one in stands}
    }
    if options.fold or (options.fold is None and len(members) >= FOLD_FROM):
        stands, members = _fold(stands, copies, labelled.patterns | labelled.probes)
    lines = sorted(stands, key=lambda one: one.edge)
    many = options.limit is None and len(lines) > MOST_LINES
    crowded = many or (single and len(folded.subjects) > GROUP_FROM)
    matrices = crowded if options.group is None else options.group
    shown = shown_edges(lines, options, matrices=matrices)
    kept = frozenset(shown)
    left += (one for line in lines if line not in kept for one in stands[line])
    marks: dict[str, list[LabelledEdge]] = defaultdict(list)
    for one in marked:
        marks[one.edge.subject].append(one)
    left_out = Counter((one.outcome(options.transport), one.edge.object.kind) for one in left)
    stands = {one: stands[one] for one in shown}
    subjects = {name: folded.subjects[name] for name in sorted(folded.subjects, key=natural_order)}
    parts = (subjects, folded.classes, folded.others, marks, members, copies, matrices)
    return SimplifiedGraph(labelled, options, shown, stands, *parts, left_out + Counter(labelled.omitted))


# -- edges that another stands for -----------------------------------------------------------------------------------


def _without_parts(stands: Mapping[LabelledEdge, Sequence[LabelledEdge]]) -> _Stands:
    """Return the edges without services and topics of actions and parameters that a subject may use as a whole."""
    whole_of: dict[tuple[Edge, object], LabelledEdge] = {}
    for one in stands:
        edge = one.edge
        for kind, permission, suffix in PARTS.get((edge.object.kind, edge.permission), ()):
            part = Edge(edge.subject, permission, Object(kind, edge.object.name + suffix), edge.domain)
            whole_of[part, one.judged] = one
    found: _Stands = defaultdict(list)
    for one, those in stands.items():
        found[whole_of.get((one.edge, one.judged), one)] += those
    return dict(found)


def _without_marked(stands: _Stands, options: DrawingOptions) -> tuple[_Stands, tuple[LabelledEdge, ...]]:
    """Return the edges, and those that a mark stands for: a common rule allows them, and so does the transport."""
    common = (one for one in stands if one.common and not options.common)
    marked = dict.fromkeys(one for one in common if one.outcome(options.transport) is EdgeOutcome.ALLOW)
    return {one: those for one, those in stands.items() if one not in marked}, tuple(marked)


def _copies(stands: Mapping[LabelledEdge, Sequence[LabelledEdge]]) -> Mapping[DomainObject, tuple[DomainObject, ...]]:
    """Return the objects that the object of each edge stands for."""
    copies: dict[DomainObject, dict[DomainObject, None]] = defaultdict(dict)
    for one, those in stands.items():
        copies[one.edge.domain_object].update(dict.fromkeys(each.edge.domain_object for each in those))
    return {key: tuple(each) for key, each in copies.items()}


# -- folded objects --------------------------------------------------------------------------------------------------


def _fold(
    stands: _Stands, copies: Mapping[DomainObject, Sequence[DomainObject]], unreal: Collection[Object]
) -> tuple[_Stands, dict[DomainObject, tuple[DomainObject, ...]]]:
    """Fold objects of one kind and namespace whose edges have the same subjects, permissions and labels.

    Returns:
        The edges of the first object of each fold, by name, and the objects of each fold.
    """
    signatures: dict[DomainObject, set[object]] = defaultdict(set)
    for one in stands:
        signatures[one.edge.domain_object].add((one.edge.subject, one.edge.permission, one.judged))
    folds: dict[object, list[DomainObject]] = defaultdict(list)
    for (domain, object_), signature in signatures.items():
        place = (
            domain,
            object_.kind,
            namespace(object_.name),
            object_.partitions,
            object_ in unreal,
            len(copies[domain, object_]),
        )
        folds[(*place, frozenset(signature))].append((domain, object_))
    first_of = {key: min(fold) for fold in folds.values() for key in fold}
    drawn = {
        (one.edge.subject, one.edge.permission, one.edge.domain_object, one.judged): one
        for one in stands
        if first_of[one.edge.domain_object] == one.edge.domain_object
    }
    found: _Stands = defaultdict(list)
    for one, those in stands.items():
        first = first_of[one.edge.domain_object]
        found[drawn[one.edge.subject, one.edge.permission, first, one.judged]] += those
    return dict(found), {min(fold): tuple(sorted(fold)) for fold in folds.values()}


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
