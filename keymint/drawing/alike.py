# SPDX-License-Identifier: Apache-2.0
"""Robots that are equal up to the name, so that a picture may show one of them for all: proven, never guessed.

A name is read as words; those that are the name of a robot stand for it. Two robots are alike if the whole graph stays
the same, edge by edge with its labels, when their names are exchanged wherever they occur: in subjects, objects and
partitions. Such exchanges can be combined, so all members of a class may be renamed in any order.
"""

from __future__ import annotations

import functools
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from comarmor.text import natural_order
from comarmor.values import Data
from keymint.api.graph import DomainObject, Edge, Object
from keymint.drawing.labelled_graph import LabelledEdge

_DEEPEST = 6
"""Levels of names at which robots are looked for."""

_Named = tuple[int, tuple[str, ...]]
"""An edge: the number of its form, which is all but the names of robots, and the robots in order, each once."""


class Alike(Data):
    """Robots, or single subjects, that are equal up to the name.

    Attributes:
        like: the one that is drawn, as the beginning of a name: ``/robot1``.
        names: all of them, in natural order.
        single: whether each is a subject without others below it.
    """

    like: str
    names: tuple[str, ...]
    single: bool


class AlikeFold(Data):
    """A graph of which one robot of each class is drawn.

    Attributes:
        edges: the edges that remain, each with all edges that it stands for.
        subjects: the subjects that remain, in natural order, each with all that it stands for.
        others: objects of another robot of a class than the subjects at their edges.
        classes: the classes of robots of which one remains.
    """

    edges: Mapping[LabelledEdge, Sequence[LabelledEdge]]
    subjects: Mapping[str, tuple[str, ...]]
    others: frozenset[DomainObject]
    classes: tuple[Alike, ...]


def fold_alike(edges: Sequence[LabelledEdge], subjects: Sequence[str], deepest: int = _DEEPEST) -> AlikeFold:
    """Return a graph of which one robot of each class is drawn; every edge stands for itself or for equal ones.

    Args:
        edges: the edges.
        subjects: the subjects.
        deepest: levels of names at which robots are looked for.
    """
    nodes = {name: LabelledEdge(Edge(name, "", Object("", ""))) for name in subjects}  # a subject: an edge to nothing
    drawn = {one: one for one in (*nodes.values(), *edges)}
    classes: list[Alike] = []
    others: set[LabelledEdge] = set()
    for depth in range(1, deepest + 1):
        robots = sorted({_robot(name, depth) for name in subjects} - {""}, key=natural_order)
        if not robots:
            break
        named = _named(drawn, robots)
        groups = _groups(robots, named.values())
        there = {_robot(drawn[node].edge.subject, depth) for node in nodes.values()}
        for group in groups:
            if len(there.intersection(group)) > 1:
                names = tuple(f"/{robot}" for robot in group)
                single = not any(subject.startswith(f"{names[0]}/") for subject in subjects)
                classes.append(Alike(names[0], names, single))
        group_of = {robot: group for group in groups for robot in group}
        by_name = {found: one for one, found in named.items()}
        for one, now in drawn.items():
            form, those = named[now]
            first: list[str] = []
            for robot in those:
                first.append(next(each for each in group_of[robot] if each not in first))
            drawn[one] = by_name[form, tuple(first)]
            if any(group_of[robot][0] != robot for robot in first):
                others.add(drawn[one])
    stands: dict[LabelledEdge, list[LabelledEdge]] = defaultdict(list)
    for one in edges:
        stands[drawn[one]].append(one)
    members: dict[str, list[str]] = defaultdict(list)
    for name, node in nodes.items():
        members[drawn[node].edge.subject].append(name)
    kept = tuple(each for each in classes if any(f"{name}/".startswith(f"{each.like}/") for name in members))
    another = frozenset(one.edge.domain_object for one in stands if one in others)
    names_of = {name: tuple(members[name]) for name in sorted(members, key=natural_order)}
    return AlikeFold(stands, names_of, another, kept)


def _robot(subject: str, depth: int) -> str:
    """Return the robot of a subject, of so many segments; empty if the name has fewer."""
    segments = subject.split("/")[1 : depth + 1]
    return "/".join(segments) if len(segments) == depth else ""


def _named(edges: Iterable[LabelledEdge], robots: Sequence[str]) -> Mapping[LabelledEdge, _Named]:
    """Return edges with the names of robots replaced by numbers, wherever these are words of a name."""
    longest_first = "|".join(map(re.escape, sorted(robots, key=len, reverse=True)))
    parts_of = functools.cache(re.compile(f"(?<![A-Za-z0-9])({longest_first})(?![A-Za-z0-9])").split)
    found: dict[LabelledEdge, _Named] = {}
    forms: dict[tuple[object, ...], int] = {}
    for one in edges:
        edge = one.edge
        form: list[object] = [edge.permission, edge.domain, one.judged]
        numbers: dict[str, int] = {}
        for text in (edge.subject, edge.object.name, *edge.object.partitions):
            parts = enumerate(parts_of(text))  # every other part is a robot
            form.append(tuple(numbers.setdefault(part, len(numbers)) if at % 2 else part for at, part in parts))
        found[one] = forms.setdefault(tuple(form), len(forms)), tuple(numbers)
    return found


def _groups(robots: Sequence[str], named: Iterable[_Named]) -> Sequence[Sequence[str]]:
    """Return the classes of robots of which any two may be exchanged."""
    known = frozenset(named)
    naming: dict[str, list[_Named]] = defaultdict(list)
    for form, those in known:
        for robot in those:
            naming[robot].append((form, those))

    def exchangeable(one: str, other: str) -> bool:
        exchanged = {one: other, other: one}
        return all(
            (form, tuple(exchanged.get(robot, robot) for robot in those)) in known
            for form, those in (*naming[one], *naming[other])
        )

    # Only robots with the same edges of their own can be alike.
    candidates: dict[frozenset[int], list[list[str]]] = defaultdict(list)
    for robot in robots:
        groups = candidates[frozenset(form for form, those in naming[robot] if len(those) == 1)]
        group = next((each for each in groups if exchangeable(each[0], robot)), None)
        if group is None:
            groups.append([robot])
        else:
            group.append(robot)
    return [group for groups in candidates.values() for group in groups]
