"""Folds objects that nothing tells apart into one, so that large graphs stay readable."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from keymint.drawing.display_text import KINDS, printable
from keymint.drawing.labelled_graph import LabelledEdge, namespace
from keymint.drawing.layout import DomainObject
from keymint.graph import Object

Signature = tuple[object, ...]


def fold(
    edges: Sequence[LabelledEdge],
) -> tuple[tuple[LabelledEdge, ...], dict[DomainObject, tuple[DomainObject, ...]]]:
    """Fold objects of one kind and namespace whose edges have the same subjects, permissions and labels.

    Args:
        edges: the edges.

    Returns:
        The edges of one object for each of them, the first by name, and the objects that each of these stands for.
    """
    signatures: dict[DomainObject, list[Signature]] = defaultdict(list)
    for one in edges:
        said = tuple(said and said.allowed for said in (one.policy, *one.transports))
        signatures[one.edge.domain, one.edge.object].append((one.edge.subject, one.edge.permission, one.audit, *said))
    alike: dict[Signature, list[DomainObject]] = defaultdict(list)
    for (domain, found), signature in signatures.items():
        place = (domain, found.kind, namespace(found.name), found.partitions)
        alike[(*place, frozenset(signature))].append((domain, found))
    members = {min(group): tuple(sorted(group)) for group in alike.values()}
    return tuple(one for one in edges if (one.edge.domain, one.edge.object) in members), members


def folded_name(members: Sequence[DomainObject]) -> str:
    """Return the label of several objects in one: ``/talker/… (6 services)``."""
    first: Object = members[0][1]
    noun = KINDS.get(first.kind, first.kind)
    return printable(f"{namespace(first.name)}… ({len(members)} {noun}{'' if noun.endswith('s') else 's'})")
