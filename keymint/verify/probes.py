# SPDX-License-Identifier: Apache-2.0
"""Generate names to test without a graph: names in the policy, and names that probe its patterns.

A pattern is probed inside, where it must match, and just outside, where it must not: an empty text, one character, a
slash and several segments for ``*``; a few members of a class and their neighbours; one character more or less at
either end; the other case. A document whose pattern is wider or narrower than the policy's differs on one of them.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import chain, islice
from types import MappingProxyType

from comarmor.patterns import glob
from comarmor.patterns.tokens import Charset, PatternError
from comarmor.rules import PARTS
from keymint.api.graph import LABELLED, Edge, Object
from keymint.ir import Rule, SubjectRules
from keymint.verify.endpoint_policy import RAW

MOST_OF_A_PATTERN = 48
"""Limit of probing names per pattern."""
MOST_OF_OTHERS = 2_000
"""Limit of objects from rules of other subjects that a subject is tested with."""
MOST_OF_INSTALLED = 4
"""Limit of names per pattern of a shared document: what it was compiled from is probed in full."""
_MOST_OF_A_CLASS = 6
_FILLINGS = ("", "x", "y/z", "_0", "/n")
_PLAIN = string.ascii_letters + string.digits + "_/"
"""Characters of topic names on every transport; generated names have no others."""


def edges(
    rules: Iterable[SubjectRules],
    common: Iterable[Object],
    domains: Mapping[str, int],
    named: Callable[[Object], bool] = lambda _object: True,
    mentioned: Callable[[str], Iterable[Edge]] = lambda _subject: (),
    needed: Callable[[Edge], Iterable[Edge]] = lambda _edge: (),
) -> Iterator[Edge]:
    """Yield edges to test, grouped by subject, without duplicates.

    Every subject is tested with the objects of its own rules and their probes, with common objects, and with further
    objects of its documents.

    Args:
        rules: the rules of each subject, sorted by subject.
        common: see :func:`common_objects`.
        domains: the domain of each subject.
        named: returns whether an object has a name on the transport; others are not tested.
        mentioned: returns edges of kind ``topic`` on the objects in the documents of a subject.
        needed: returns the endpoints of an edge, which need not be tested again.
    """
    for each in rules:
        own = {object_ for rule in each.rules for object_ in _objects(rule, probe=True)}
        yielded: set[Edge] = set()
        for object_ in sorted(own.union(common)):
            if not named(object_):
                continue
            for permission in LABELLED[object_.kind]:
                edge = Edge(each.subject, permission, object_, domains.get(each.subject, 0))
                yielded.update((edge, *needed(edge)))
                yield edge
        yield from (edge for edge in dict.fromkeys(mentioned(each.subject)) if edge not in yielded)


def common_objects(rules: Iterable[SubjectRules], installed: Iterable[str] = ()) -> tuple[Object, ...]:
    """Return the objects that every subject is asked about: those that rules name, and examples of other patterns.

    Args:
        rules: the rules of all subjects.
        installed: expressions of ROS names in shared documents; those that rules name are left out.

    Returns:
        At most :data:`MOST_OF_OTHERS` objects of each, an even selection if there are more.
    """
    named = {object_ for each in rules for rule in each.rules for object_ in _objects(rule, probe=False)}
    known = {object_.name for object_ in named}
    shown = sorted({name for each in installed if each not in known for name in names(each)[:MOST_OF_INSTALLED]})
    found = [Object(kind, name) for name in shown if name[:1] == "/" for kind in ("ros_topic", "ros_service")]
    return tuple(dict.fromkeys((*_selected(sorted(named)), *_selected(found))))


def named_objects(rules: SubjectRules) -> Iterator[Object]:
    """Yield the objects that rules name without a wildcard, with the topics and services that these consist of."""
    for rule in rules.rules:
        partitions = [text for each in rule.partitions if (text := glob.literal(glob.parse(each)))]
        for name in filter(None, map(glob.literal, map(glob.parse, rule.expressions))):
            yield from (Object(rule.kind, name, each) for each in ((), *((text,) for text in partitions)))
            for permission in rule.permissions:
                yield from (Object(kind, name + suffix) for kind, _, suffix in PARTS.get((rule.kind, permission), ()))


def _selected(objects: Sequence[Object]) -> Sequence[Object]:
    return objects[:: max(1, -(-len(objects) // MOST_OF_OTHERS))]


def raw_edges(subject: str, expression: str, partitions: Sequence[str], domain: int) -> Iterator[Edge]:
    """Yield edges that probe an expression of topics, and the expressions of partitions beside it."""
    try:
        text = glob.literal(glob.parse(expression))
        topics = (text,) if text else names(expression)
        lists = tuple(dict.fromkeys(_partitions(partitions, RAW, probe=True))) if partitions else ((),)
    except PatternError:
        return  # not an expression of any policy; only the transport can read it
    for name in filter(None, topics):
        for each in lists:
            for permission in LABELLED[RAW]:
                yield Edge(subject, permission, Object(RAW, name, each), domain)


def names(expression: str) -> tuple[str, ...]:
    """Return names that probe an expression, the likeliest first, at most :data:`MOST_OF_A_PATTERN`.

    A literal is returned with its neighbours: one character more or less, the other case, a parent and a child.
    """
    return tuple(islice(dict.fromkeys(_names(expression)), MOST_OF_A_PATTERN))


def _objects(rule: Rule, *, probe: bool) -> Iterator[Object]:
    """Yield the objects of a rule, and objects that probe its patterns."""
    # Something stands for each '*' of an example.
    named = (names(each) if probe else (_filled(glob.parse(each), "x"),) for each in rule.expressions)
    for name in chain.from_iterable(named):
        if not (name and _is_plain(name)) or (rule.kind != RAW and name[0] != "/"):
            continue  # no topic has such a name
        yield from (Object(rule.kind, name, each) for each in _partitions(rule.partitions, rule.kind, probe=probe))
        for permission in rule.permissions:
            for kind, _, suffix in PARTS.get((rule.kind, permission), ()):
                yield Object(kind, name + suffix)


def _partitions(expressions: Sequence[str], kind: str, *, probe: bool) -> Iterator[tuple[str, ...]]:
    """Yield lists of partitions that probe a rule's."""
    yield ()
    if kind != RAW or not probe:
        return
    if not expressions:
        yield ("keymint_probe",)
        return
    inside = []
    for expression in expressions:
        parsed = glob.parse(expression)
        text = glob.literal(parsed)
        matching = [text] if text is not None else [_filled(parsed, filling) for filling in _FILLINGS[:3]]
        inside += matching
        yield from ((name,) for name in matching if name)
        yield from ((name + "x",) for name in matching[:1])
    named = sorted({name for name in inside if name})
    yield from (("", name) for name in named[:1])
    if len(named) > 1:
        yield tuple(named[:2])


@lru_cache(maxsize=1 << 14)
def _names(expression: str) -> tuple[str, ...]:
    parsed = glob.parse(expression)
    text = glob.literal(parsed)
    if text is not None:
        return text, *filter(_is_plain, (text + "x", text[:-1], text.swapcase(), text + "/x", "/x" + text, text[1:]))
    probes = [_filled(parsed, filling) for filling in _FILLINGS]
    plain = probes[1]
    probes += [plain + "x", plain[:-1], plain.swapcase(), "/x" + plain, plain + "/x", plain[1:], probes[0][:-1]]
    for at, token in enumerate(parsed):
        near: tuple[str, ...] = ()
        if isinstance(token, str):
            near = token[:-1], token[1:], token.swapcase(), token + "x"
        elif isinstance(token, Charset):
            near = "", *_around(token)
        probes += [_filled(parsed, "x", {at: text}) for text in near]
    return tuple(filter(_is_plain, probes))


def _is_plain(name: str) -> bool:
    return all(char in _PLAIN for char in name)


def _filled(parsed: glob.Glob, filling: str, but: Mapping[int, str] = MappingProxyType({})) -> str:
    """Return a name that a pattern matches: each ``*`` is the filling, each class one of its characters.

    That is the character that is in the fewest other classes. If the sample for ``?`` were also in a narrower class, a
    probe could not detect a change of that class.

    Args:
        parsed: the pattern.
        filling: text in place of each ``*``.
        but: texts in place of some tokens, so that the name differs from what the pattern matches.
    """
    classes = [token for token in parsed if isinstance(token, Charset)]

    def sample(members: Charset) -> str:
        inside = [char for char in _PLAIN if char in members]
        return min(inside, key=lambda char: sum(char in each for each in classes), default="")

    return glob.filled_text(tuple(but.get(at, token) for at, token in enumerate(parsed)), filling, sample)


def _around(members: Charset) -> Iterator[str]:
    """Yield some members of a class, first and last ones among them, and the characters next to it."""
    inside = [char for char in _PLAIN if char in members]
    half = _MOST_OF_A_CLASS // 2
    yield from dict.fromkeys((*inside[:half], *inside[-half:]))
    outside = [char for char in _PLAIN if char not in members]
    edges_of = [code for low, high in members.ranges for code in (low, high)]
    yield from sorted(outside, key=lambda char: min(abs(ord(char) - code) for code in edges_of))[:2]
    yield "/" if "/" in members else ""
