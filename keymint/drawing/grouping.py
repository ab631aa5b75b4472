"""Puts the subjects of a namespace together, so that the picture of a fleet stays readable."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

from comarmor.text import counted
from keymint.drawing.labelled_graph import LabelledEdge, namespace

GROUP_FROM = 30
"""Subjects of a graph beyond which they are grouped, and the most groups where names have the levels for it."""


def groups(subjects: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
    """Return the subjects of each group by what the group is called; a subject alone in its namespace is itself.

    The groups are the namespaces of the deepest level that has at most :data:`GROUP_FROM` of them.

    Args:
        subjects: names, sorted.
    """
    deepest = max((namespace(subject).count("/") for subject in subjects), default=1)
    found: Mapping[str, Sequence[str]] = {}
    for depth in range(deepest, 0, -1):
        found = _at(depth, subjects)
        if len(found) <= GROUP_FROM:
            break
    named: dict[str, tuple[str, ...]] = {}
    for prefix, members in found.items():
        name = members[0] if len(members) == 1 else f"{prefix}… ({counted(len(members), 'subject')})"
        named[name] = tuple(members)
    return named


def _at(depth: int, subjects: Sequence[str]) -> Mapping[str, Sequence[str]]:
    """Return subjects by the first levels of their namespaces, so many that ``/`` alone is one."""
    found: dict[str, list[str]] = defaultdict(list)
    for subject in subjects:
        levels = namespace(subject).split("/")[:depth]
        found["/".join([*levels, ""])].append(subject)
    return found


def grouped(edges: Sequence[LabelledEdge], members: Mapping[str, Sequence[str]]) -> tuple[LabelledEdge, ...]:
    """Return the edges of groups: one for all members that have it with the same labels.

    Args:
        edges: the edges of subjects.
        members: the subjects of each group.
    """
    group_of = {subject: name for name, subjects in members.items() for subject in subjects}
    found: dict[tuple[object, ...], LabelledEdge] = {}
    for one in edges:
        edge = replace(one.edge, subject=group_of[one.edge.subject])
        labels = tuple(said and said.allowed for said in (one.policy, *one.transports))
        found.setdefault((edge, labels, one.audit), replace(one, edge=edge))
    return tuple(sorted(found.values(), key=lambda one: one.edge))
