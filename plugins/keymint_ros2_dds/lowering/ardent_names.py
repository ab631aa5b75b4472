"""Names of ROS 2 Ardent: the namespace is a DDS partition, and only the base name is the topic's.

A topic ``/a/b`` is the DDS topic ``b`` in the partition ``rt/a``, and ``/b`` is ``b`` in ``rt``; a service ``/a/s`` is
``sRequest`` in ``rq/a`` and ``sReply`` in ``rr/a``. Read backwards, a topic ``T`` in a partition ``P`` is the name
``P/T`` without its prefix; so a topic with a ``/`` in its name, which Ardent itself never makes, has a meaning, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.relations import covers
from comarmor.patterns.tokens import STAR, Charset, Star, Token
from keymint_ros2_dds.lowering.entities import Image

MAX_ALTERNATIVES = 64
"""Partitions that the bracket expressions of a namespace may stand for."""

Pair = tuple[Glob, Glob]
"""Patterns of a partition and of a topic: every topic that matches, in every partition that matches."""


def image(expression: Glob, mapped: Image, part: str = "", *, every: bool = False) -> tuple[Pair, ...]:
    """Return pairs for exactly the DDS names of the ROS names that an expression matches.

    The last ``/`` of a name divides it, and a wildcard may be what matches that ``/``: ``/a*`` is ``a*`` in ``rt``, and
    everything in ``rt/a*``.

    Args:
        expression: an expression over ROS names.
        mapped: where the names go; not that of a raw topic.
        part: the part of a composite that follows the names, e.g. ``/get_parameters``.
        every: divide at every ``/``, not only at the last one. What denies must, since a pair such as ``*`` in ``rt``
            also matches topics with a ``/`` in their name.
    """
    found: dict[Pair, None] = {}
    for rest in glob.after(glob.surround("", expression, part), "/"):
        for namespace, base in _divided(rest):
            if every or not any(isinstance(token, str) and "/" in token for token in base):
                topic = glob.surround("", base, mapped.suffix)
                for each in _alternatives(glob.surround(mapped.prefix, namespace, "")):
                    found[each, topic] = None
    return _maximal(found)


def _divided(rest: Glob) -> Iterator[Pair]:
    """Yield namespace (empty, or with its leading ``/``) and base name for every ``/`` that may divide them.

    Args:
        rest: what follows the ``/`` at the beginning of a name.
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
    """Yield a pattern with its small sets written out: of partitions, vendors read only names and ``*`` safely."""
    choices: list[tuple[Token, ...]] = []
    count = 1
    for token in pattern:
        small = isinstance(token, Charset) and count * len(token) <= MAX_ALTERNATIVES
        choices.append(tuple(token.chars()) if small and isinstance(token, Charset) else (token,))
        count *= len(choices[-1])
    for tokens in product(*choices):
        yield glob.normalise(tokens)


def _maximal(pairs: Iterable[Pair]) -> tuple[Pair, ...]:
    """Leave out the pairs that another one covers."""
    kept: list[Pair] = []
    for pair in pairs:
        if not any(_covers(other, pair) for other in kept):
            kept = [*(other for other in kept if not _covers(pair, other)), pair]
    return tuple(kept)


def _covers(outer: Pair, inner: Pair) -> bool:
    return covers(outer[0], inner[0]) and covers(outer[1], inner[1])
