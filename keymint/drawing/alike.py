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

from comarmor.values import dataclass
from keymint.api.graph import DomainObject
from keymint.drawing.labelled_graph import LabelledEdge

_DEEPEST = 6
"""Levels of names at which robots are looked for."""

_Form = tuple[object, ...]
"""An edge or a subject without the names of robots: numbers stand for them, in the order in which they occur."""
_Robots = tuple[str, ...]
"""The robots of an edge in this order, each once."""


@dataclass(frozen=True, slots=True)
class Alike:
    """Robots, or single subjects, that are equal up to the name.

    Attributes:
        like: the one that is drawn, as the beginning of a name: ``/robot1``.
        names: all of them, in natural order.
        single: whether each is a subject without others below it.
    """

    like: str
    names: tuple[str, ...]
    single: bool


@dataclass(frozen=True, slots=True)
class AlikeFold:
    """A graph of which one robot of each class is drawn.

    Attributes:
        edges: the edges that remain, each with all edges that it stands for.
        subjects: the subjects that remain, each with all that it stands for.
        others: objects of another robot of a class than the subjects at their edges.
        classes: the classes of robots of which one remains.
    """

    edges: Mapping[LabelledEdge, Sequence[LabelledEdge]]
    subjects: Mapping[str, tuple[str, ...]]
    others: frozenset[DomainObject]
    classes: tuple[Alike, ...]


def natural(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts numbers in names by value: ``r2`` before ``r10``."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", name)]


def fold_alike(edges: Sequence[LabelledEdge], subjects: Sequence[str]) -> AlikeFold:
    """Return a graph of which one robot of each class is drawn; every edge stands for itself or for equal ones."""
    drawn: dict[LabelledEdge, LabelledEdge] = {one: one for one in edges}
    names: dict[str, str] = {subject: subject for subject in subjects}
    classes: list[Alike] = []
    others: set[DomainObject] = set()
    for depth in range(1, min(_DEEPEST, max((subject.count("/") for subject in subjects), default=0)) + 1):
        level = _Level(edges, subjects, depth)
        found = level.classes()
        if found:
            there = {f"/{level.robot(name)}" for name in names.values()}
            new = (_class(each, subjects) for each in {each[0]: each for each in found.values()}.values())
            classes += (each for each in new if len(there.intersection(each.names)) > 1)
            drawn = {one: level.edge(drawn[one], found) for one in edges}
            names = {subject: level.subject(names[subject], found) for subject in subjects}
            others |= {one.edge.domain_object for one in drawn.values() if level.names_another(one, found)}
    stands: dict[LabelledEdge, list[LabelledEdge]] = defaultdict(list)
    for one in edges:
        stands[drawn[one]].append(one)
    members: dict[str, list[str]] = defaultdict(list)
    for subject in subjects:
        members[names[subject]].append(subject)
    kept = tuple(each for each in classes if any(_below(name, each.like) for name in members))
    remaining = {name: tuple(of_name) for name, of_name in members.items()}
    return AlikeFold(stands, remaining, frozenset(others & {one.edge.domain_object for one in stands}), kept)


def _class(members: Sequence[str], subjects: Iterable[str]) -> Alike:
    names = tuple(f"/{robot}" for robot in members)
    return Alike(names[0], names, not any(subject.startswith(f"{names[0]}/") for subject in subjects))


def _below(name: str, prefix: str) -> bool:
    return name == prefix or name.startswith(f"{prefix}/")


class _Level:
    """The edges and subjects of a graph, with the names of all robots at one level replaced.

    Args:
        edges: the edges.
        subjects: the subjects.
        depth: the number of segments in the name of a robot.
    """

    def __init__(self, edges: Sequence[LabelledEdge], subjects: Sequence[str], depth: int) -> None:
        self._depth = depth
        self._robots = sorted({self.robot(subject) for subject in subjects} - {""}, key=natural)
        self._known = frozenset(self._robots)
        self._lengths = sorted({len(_words(robot)) for robot in self._robots}, reverse=True)
        self._read = functools.cache(self._reading)
        self._at: dict[_Form, dict[_Robots, LabelledEdge | str]] = defaultdict(dict)
        things: Sequence[LabelledEdge | str] = (*subjects, *edges)
        for thing in things:
            form, robots = self._formed(thing)
            self._at[form][robots] = thing

    def robot(self, subject: str) -> str:
        """Return the robot of a subject; empty if the name has no such level."""
        segments = subject.split("/")[1 : self._depth + 1]
        return "/".join(segments) if len(segments) == self._depth else ""

    def classes(self) -> Mapping[str, Sequence[str]]:
        """Return the robots that are alike, by each of them."""
        own: dict[str, set[_Form]] = defaultdict(set)
        shared: dict[str, list[tuple[_Form, _Robots]]] = defaultdict(list)
        for form, places in self._at.items():
            for robots in places:
                if len(robots) == 1:
                    own[robots[0]].add(form)
                else:
                    for robot in robots:
                        shared[robot].append((form, robots))
        # Only robots with the same edges of their own can be alike; edges with several robots are compared apart.
        candidates: dict[frozenset[_Form], list[list[str]]] = defaultdict(list)
        for robot in self._robots:
            groups = candidates[frozenset(own[robot])]
            fitting = (each for each in groups if self._exchangeable(each[0], robot, shared))
            group = next(fitting, None)
            if group is None:
                groups.append([robot])
            else:
                group.append(robot)
        return {robot: each for groups in candidates.values() for each in groups if len(each) > 1 for robot in each}

    def _exchangeable(self, one: str, other: str, shared: Mapping[str, Sequence[tuple[_Form, _Robots]]]) -> bool:
        exchanged = {one: other, other: one}
        return all(
            tuple(exchanged.get(robot, robot) for robot in robots) in self._at[form]
            for form, robots in (*shared.get(one, ()), *shared.get(other, ()))
        )

    def edge(self, one: LabelledEdge, classes: Mapping[str, Sequence[str]]) -> LabelledEdge:
        """Return the edge that is drawn for an edge."""
        form, robots = self._formed(one)
        found = self._at[form][_first(robots, classes)]
        return found if isinstance(found, LabelledEdge) else one

    def subject(self, name: str, classes: Mapping[str, Sequence[str]]) -> str:
        """Return the subject that is drawn for a subject."""
        form, robots = self._formed(name)
        return str(self._at[form][_first(robots, classes)])

    def names_another(self, one: LabelledEdge, classes: Mapping[str, Sequence[str]]) -> bool:
        """Tell whether the object of an edge that is drawn is of another robot than its subject."""
        _, robots = self._formed(one)
        return any(robot in classes and classes[robot][0] != robot for robot in robots)

    def _formed(self, thing: LabelledEdge | str) -> tuple[_Form, _Robots]:
        texts: Sequence[str] = [thing] if isinstance(thing, str) else ()
        rest: _Form = ()
        if not isinstance(thing, str):
            edge = thing.edge
            texts = [edge.subject, edge.object.name, *edge.object.partitions]
            explicit = thing.policy is not None and thing.policy.where is not None
            rest = (edge.permission, edge.domain, thing.decisions, thing.audit, thing.common, explicit)
        numbers: dict[str, int] = {}
        form = tuple(
            tuple(numbers.setdefault(word, len(numbers)) if is_robot else word for word, is_robot in self._read(text))
            for text in texts
        )
        return (*form, *rest), tuple(numbers)

    def _reading(self, text: str) -> Sequence[tuple[str, bool]]:
        """Return the words of a name, each with whether it is the name of a robot."""
        words, found, at = _words(text), [], 0
        while at < len(words):
            length = next((each for each in self._lengths if "".join(words[at : at + each]) in self._known), 0)
            found.append(("".join(words[at : at + max(length, 1)]), length > 0))
            at += max(length, 1)
        return found


def _words(text: str) -> list[str]:
    """Return the words of a name and what separates them."""
    return re.split(r"([^A-Za-z0-9])", text)


def _first(robots: _Robots, classes: Mapping[str, Sequence[str]]) -> _Robots:
    """Return the first robots of the same classes, each once."""
    used: dict[str, int] = defaultdict(int)
    first = []
    for robot in robots:
        group = classes.get(robot, (robot,))
        first.append(group[used[group[0]]])
        used[group[0]] += 1
    return tuple(first)
