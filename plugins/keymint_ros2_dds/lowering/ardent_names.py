# SPDX-License-Identifier: Apache-2.0
"""ROS names as DDS topics in ROS 2 Ardent: the namespace is a DDS partition, the topic has the base name only.

The topic ``/a/b`` is the DDS topic ``b`` in the partition ``rt/a``, and ``/b`` is ``b`` in ``rt``; the service ``/a/s``
is ``sRequest`` in ``rq/a`` and ``sReply`` in ``rr/a``. In reverse, a topic ``T`` in a partition ``P`` is the name
``P/T`` without its prefix. So a topic with a ``/`` in its name, which Ardent itself never creates, has a meaning too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.relations import covers
from comarmor.patterns.tokens import STAR, Charset, Star, Token
from keymint_ros2_dds.lowering.dds_topics import DdsTopic

MAX_ALTERNATIVES = 64
"""Partitions that the bracket expressions of a namespace may expand to."""

Pair = tuple[Glob, Glob]
"""Patterns of a partition and of a topic: every topic that matches, in every partition that matches."""


def dds_patterns(expression: Glob, topic: DdsTopic, part: str = "", *, every: bool = False) -> tuple[Pair, ...]:
    """Return pairs that match exactly the DDS names of the ROS names that an expression matches.

    The last ``/`` of a name divides it, and a wildcard may match that ``/``: ``/a*`` is ``a*`` in ``rt``, and
    everything in ``rt/a*``.

    Args:
        expression: an expression over ROS names.
        topic: the DDS topic that the names map to; not a raw topic.
        part: the part of a composite that follows the names, e.g. ``/get_parameters``.
        every: divide at every ``/``, not only at the last one. Denials must, since a pair such as ``*`` in ``rt``
            also matches topics with a ``/`` in their name.
    """
    pairs: dict[Pair, None] = {}
    for rest in glob.left_quotient(glob.surround("", expression, part), "/"):
        for namespace, base in _divided(rest):
            if every or not any(isinstance(token, str) and "/" in token for token in base):
                name = glob.surround("", base, topic.suffix)
                for partition in _alternatives(glob.surround(topic.prefix, namespace, "")):
                    pairs[partition, name] = None
    return _maximal(pairs)


def _divided(rest: Glob) -> Iterator[Pair]:
    """Yield namespace (empty, or with its leading ``/``) and base name for every ``/`` that may divide them.

    Args:
        rest: the pattern after the ``/`` at the beginning of a name.
    """
    yield (), rest
    tokens = glob.units(rest)
    for at, token in enumerate(tokens):
        left, right = tokens[:at], tokens[at + 1 :]
        if isinstance(token, Star):
            yield _namespace((*left, STAR)), glob.normalise((STAR, *right))
        elif "/" in token:  # a set that holds it, or the character itself
            yield _namespace(left), glob.normalise(right)


def _namespace(tokens: Iterable[Token]) -> Glob:
    return glob.normalise(("/", *tokens))


def _alternatives(pattern: Glob) -> Iterator[Glob]:
    """Yield a pattern with its small sets expanded: in partitions, all vendors agree only on names and ``*``."""
    choices: list[tuple[Token, ...]] = []
    count = 1
    for token in pattern:
        small = isinstance(token, Charset) and count * len(token) <= MAX_ALTERNATIVES
        choices.append(tuple(token.chars()) if small and isinstance(token, Charset) else (token,))
        count *= len(choices[-1])
    for tokens in product(*choices):
        yield glob.normalise(tokens)


def _maximal(pairs: Iterable[Pair]) -> tuple[Pair, ...]:
    """Drop the pairs that another pair covers."""
    kept: list[Pair] = []
    for pair in pairs:
        if not any(_covers(other, pair) for other in kept):
            kept = [*(other for other in kept if not _covers(pair, other)), pair]
    return tuple(kept)


def _covers(outer: Pair, inner: Pair) -> bool:
    return covers(outer[0], inner[0]) and covers(outer[1], inner[1])
