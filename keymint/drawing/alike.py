# SPDX-License-Identifier: Apache-2.0
"""Robots that are equal up to the name, so that a picture may show one of them for all: proven, never guessed.

A name is read as words; those that are the name of a robot stand for it. Two robots are alike if the whole graph stays
the same, edge by edge with its labels, when their names are exchanged wherever they occur: in subjects, objects and
partitions. Such exchanges can be combined, so all members of a class may be renamed in any order.
"""

from __future__ import annotations

import functools
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

from comarmor.text import natural_order
from comarmor.values import dataclass
from keymint.api.graph import DomainObject
from keymint.drawing.labelled_graph import LabelledEdge

_DEEPEST = 6
"""Levels of names at which robots are looked for."""

_Form = tuple[object, ...]
"""An edge or a subject without the names of robots: numbers stand for them, in the order in which they occur."""
_Robots = tuple[str, ...]
"""The robots of an edge in this order, each once."""
_Thing = LabelledEdge | str
"""An edge or a subject."""


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


def fold_alike(edges: Sequence[LabelledEdge], subjects: Sequence[str]) -> AlikeFold:
    """Return a graph of which one robot of each class is drawn; every edge stands for itself or for equal ones."""
    things: Sequence[_Thing] = (*subjects, *edges)
    drawn = {thing: thing for thing in things}
    deepest = max((subject.count("/") for subject in subjects), default=0)
    classes: list[Alike] = []
    others: set[_Thing] = set()
    for depth in range(1, min(_DEEPEST, deepest) + 1):
        level = _Level(things, depth)
        if found := level.classes():
            there = {f"/{level.robot(now)}" for now in drawn.values() if isinstance(now, str)}
            for first, names in {each[0]: tuple(f"/{robot}" for robot in each) for each in found.values()}.items():
                if len(there.intersection(names)) > 1:
                    single = not any(subject.startswith(f"/{first}/") for subject in subjects)
                    classes.append(Alike(names[0], names, single))
            drawn = {thing: level.drawn(now, found) for thing, now in drawn.items()}
            others |= {now for now in drawn.values() if level.names_another(now, found)}
    stands: dict[LabelledEdge, list[LabelledEdge]] = defaultdict(list)
    members: dict[str, list[str]] = defaultdict(list)
    for thing, now in drawn.items():
        if isinstance(thing, str):
            members[str(now)].append(thing)
        elif not isinstance(now, str):
            stands[now].append(thing)
    kept = tuple(each for each in classes if any(f"{name}/".startswith(f"{each.like}/") for name in members))
    another = frozenset(one.edge.domain_object for one in stands if one in others)
    return AlikeFold(stands, {name: tuple(of_name) for name, of_name in members.items()}, another, kept)


class _Level:
    """The edges and subjects of a graph, with the names of all robots at one level replaced.

    Args:
        things: the subjects and edges.
        depth: the number of segments in the name of a robot.
    """

    def __init__(self, things: Sequence[_Thing], depth: int) -> None:
        self._depth = depth
        names = {self.robot(thing) for thing in things if isinstance(thing, str)}
        self._robots = sorted(names - {""}, key=natural_order)
        self._known = frozenset(self._robots)
        self._lengths = sorted({len(_words(robot)) for robot in self._robots}, reverse=True)
        self._read = functools.cache(self._reading)
        self._formed = {thing: self._form(thing) for thing in things}
        self._at: dict[_Form, dict[_Robots, _Thing]] = defaultdict(dict)
        for thing, (form, robots) in self._formed.items():
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

    def drawn(self, thing: _Thing, classes: Mapping[str, Sequence[str]]) -> _Thing:
        """Return the edge or subject that is drawn for one: it is of the first robots of the same classes."""
        form, robots = self._formed[thing]
        used: Counter[str] = Counter()
        first = []
        for robot in robots:
            group = classes.get(robot, (robot,))
            first.append(group[used[group[0]]])
            used[group[0]] += 1
        return self._at[form][tuple(first)]

    def names_another(self, thing: _Thing, classes: Mapping[str, Sequence[str]]) -> bool:
        """Tell whether what is drawn has the name of a second robot of a class."""
        return any(robot in classes and classes[robot][0] != robot for robot in self._formed[thing][1])

    def _form(self, thing: _Thing) -> tuple[_Form, _Robots]:
        texts: Sequence[str] = [thing] if isinstance(thing, str) else ()
        rest: _Form = ()
        if not isinstance(thing, str):
            edge = thing.edge
            texts = [edge.subject, edge.object.name, *edge.object.partitions]
            rest = (edge.permission, edge.domain, thing.judged)
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
