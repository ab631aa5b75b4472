# SPDX-License-Identifier: Apache-2.0
"""Mapping of ROS names to DDS topics and partitions, by ROS 2 distribution.

Since Bouncy the full ROS name is part of the topic name, and partitions are not used: the topic ``/a`` is the DDS topic
``rt/a``; the service ``/s`` is the pair ``rq/sRequest`` and ``rr/sReply`` (design.ros2.org, "Topic and Service name
mapping to DDS"). Actions and parameters consist of topics and services. Raw topics keep their names.

In ROS 2 Ardent the namespace is a DDS partition, and the topic has the base name only. The topic ``/a/b`` is the DDS
topic ``b`` in the partition ``rt/a``, and ``/b`` is ``b`` in ``rt``; the service ``/a/s`` is ``sRequest`` in ``rq/a``
and ``sReply`` in ``rr/a``. In reverse, a topic ``T`` in a partition ``P`` is the name ``P/T`` without its prefix. So a
topic with a ``/`` in its name, which Ardent itself never creates, has a meaning too.

The other way, patterns of DDS topics become rules on ROS names. A pattern that begins with the prefix of a ROS
subsystem is that of a ROS topic; two that are the requests and the replies of the same services are a rule on services;
all parts of an action are a rule on actions. What is incomplete, and what no ROS name fits, stays a rule on DDS topics.
Nothing is lost: each rule means exactly its patterns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from types import MappingProxyType
from typing import Literal, get_args

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import matches_ros_name
from comarmor.patterns.relations import covers
from comarmor.patterns.tokens import STAR, Charset, PatternError, Star, Token
from comarmor.rules import PARTS, Effect, parts
from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint.errors import KeymintError, Origin

TopicAction = Literal["publish", "subscribe", "relay"]
"""What a rule of a permissions document permits or denies (DDS Security 1.1, 9.4.1.3.2.3)."""
TOPIC_ACTIONS: tuple[TopicAction, ...] = get_args(TopicAction)


class DdsTopic(Data):
    """A DDS topic of a ROS entity, and the action that a permission needs on it.

    Attributes:
        action: publish, subscribe or relay.
        prefix: ROS subsystem: ``rt``, ``rq`` or ``rr``; empty for a raw topic, which keeps its name.
        suffix: text after the ROS name.
    """

    action: TopicAction
    prefix: str = ""
    suffix: str = ""


DDS_TOPICS: Mapping[str, tuple[DdsTopic, ...]] = MappingProxyType(
    {
        "publish": (DdsTopic("publish"),),
        "subscribe": (DdsTopic("subscribe"),),
        "relay": (DdsTopic("relay"),),
        "ros_publish": (DdsTopic("publish", "rt"),),
        "ros_subscribe": (DdsTopic("subscribe", "rt"),),
        "ros_relay": (DdsTopic("relay", "rt"),),
        "ros_call": (DdsTopic("publish", "rq", "Request"), DdsTopic("subscribe", "rr", "Reply")),
        "ros_execute": (DdsTopic("subscribe", "rq", "Request"), DdsTopic("publish", "rr", "Reply")),
    }
)
"""The DDS topics of each permission that is not composite."""


@lru_cache(maxsize=256)
def needed_topics(kind: str, permissions: tuple[str, ...]) -> tuple[tuple[DdsTopic, str], ...]:
    """Return the DDS topics of permissions, with the suffix of each part.

    Raises:
        KeyError: DDS does not know a permission.
    """
    needed = ((part, suffix) for permission in permissions for _, part, suffix in parts(kind, permission))
    return tuple((topic, suffix) for part, suffix in needed for topic in DDS_TOPICS[part])


MAX_ALTERNATIVES = 64
"""Partitions that the bracket expressions of a namespace may expand to."""

Pair = tuple[Glob, Glob]
"""Patterns of a partition and of a topic: every topic that matches, in every partition that matches."""


def ardent_patterns(expression: Glob, topic: DdsTopic, part: str = "", *, every: bool = False) -> tuple[Pair, ...]:
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
            yield glob.normalise(("/", *left, STAR)), glob.normalise((STAR, *right))
        elif "/" in token:  # a set that holds it, or the character itself
            yield glob.normalise(("/", *left)), glob.normalise(right)


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


ARDENT = "ardent"
DISTROS: Mapping[str, Mapping[str, str]] = {
    ARDENT: {"fastdds": "1.5"},
    "bouncy": {"fastdds": "1.6"},
    "crystal": {"fastdds": "1.7"},
    "dashing": {"fastdds": "1.8"},
    "eloquent": {"fastdds": "1.9", "cyclonedds": "0.7"},
    "foxy": {"fastdds": "2.1", "cyclonedds": "0.7"},
    "galactic": {"fastdds": "2.3", "cyclonedds": "0.8"},
    "humble": {"fastdds": "2.6", "cyclonedds": "0.10"},
    "iron": {"fastdds": "2.10", "cyclonedds": "0.10"},
    "jazzy": {"fastdds": "2.14", "cyclonedds": "0.10"},
    "kilted": {"fastdds": "3.2", "cyclonedds": "0.10"},
    "lyrical": {"fastdds": "3.6", "cyclonedds": "11.0"},
    "rolling": {"fastdds": "3.6", "cyclonedds": "11.0"},
}
"""Distributions whose name mapping is known, and the versions of the vendors of DDS that each ships.

The versions are those of ``ros2.repos`` on the branch of each distribution (github.com/ros2/ros2, April 2026; the
commits that Crystal and earlier name are of these versions). Connext has no model: the standard stands for it.
"""


def dds_patterns(
    distro: str, expression: Glob, topic: DdsTopic, part: str = "", effect: Effect = Effect.ALLOW
) -> Iterable[tuple[Glob, Glob | None]]:
    """Return DDS topic patterns for the names that an expression matches, each with its partition pattern.

    The partition pattern is None where the mapping does not set the partition.

    Args:
        distro: a known distribution.
        expression: an expression over ROS names, or over DDS names for a topic without a prefix.
        topic: the DDS topic that the names map to.
        part: the part of a composite that follows the names.
        effect: the effect of the rule.
    """
    if distro == ARDENT and topic.prefix:
        pairs = ardent_patterns(expression, topic, part, every=effect is Effect.DENY)
        return [(pattern, partition) for partition, pattern in pairs]
    return [(pattern, None) for pattern in _topic_patterns(expression, topic, part)]


def _topic_patterns(expression: Glob, topic: DdsTopic, part: str) -> tuple[Glob, ...]:
    """Return the topic patterns since Bouncy.

    A ROS name begins with ``/``. So ``*/scan`` becomes ``rt/scan`` and ``rt/*/scan``, not ``rt*/scan``.
    """
    if not topic.prefix:
        return (glob.surround("", expression, topic.suffix),)
    text = glob.literal(expression)
    if text is not None:
        name = text + part
        return ((topic.prefix + name + topic.suffix,),) if name.startswith("/") else ()
    after = glob.left_quotient(glob.surround("", expression, part), "/")
    return tuple(glob.surround(topic.prefix + "/", rest, topic.suffix) for rest in after)


def parse_expression(expression: str, where: Origin) -> Glob:
    """Return the pattern of an expression of the sources.

    Raises:
        KeymintError: the expression is invalid.
    """
    try:
        return glob.parse(expression)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise KeymintError(diagnostic.message, where=where, help=diagnostic.help, code="expression") from None


def has_kind(distro: str, kind: str) -> bool:
    """Tell whether a distribution has a kind of entity. Actions came with Crystal, but Bouncy maps their parts."""
    return distro != ARDENT or kind != "ros_action"


def check_distro(distro: str) -> None:
    """Raise an error for a distribution whose name mapping is not known.

    Raises:
        KeymintError: the distribution is not known.
    """
    if distro not in DISTROS:
        help_ = did_you_mean(distro, DISTROS, f"use one of {', '.join(DISTROS)}")
        raise KeymintError(f"unknown distro {distro!r}", help=help_, code="distro-unknown")


RosPattern = tuple[str, str, Glob]
"""Kind, permission and pattern of a rule on names."""
_PERMISSIONS = {
    "ros_topic": ("ros_publish", "ros_subscribe", "ros_relay"),
    "ros_service": ("ros_call", "ros_execute"),
}
_ACTION_PARTS = {permission: of_action for (kind, permission), of_action in PARTS.items() if kind == "ros_action"}


def in_ros(patterns: Iterable[tuple[TopicAction, Glob]], distro: str) -> Mapping[RosPattern, tuple[TopicAction, Glob]]:
    """Return rules for patterns of DDS topics in the default partition, each with a pattern that it stands for.

    Args:
        patterns: what may be done, and to which topics; all allowed, or all denied.
        distro: ROS 2 distribution whose name mapping applies; Ardent's puts names into partitions.
    """
    left = dict.fromkeys(patterns)
    found: dict[RosPattern, tuple[TopicAction, Glob]] = {}
    if distro != ARDENT:
        for kind, permissions in _PERMISSIONS.items():
            for permission in permissions:
                first, *_ = topics = DDS_TOPICS[permission]
                names = (_name(pattern, first) for action, pattern in left if action == first.action)
                for name in filter(None, names):
                    if all(_topic_of(topic, name) in left for topic in topics):
                        found[kind, permission, name] = _topic_of(first, name)
        for _, permission, name in found:
            for topic in DDS_TOPICS[permission]:
                left.pop(_topic_of(topic, name), None)
        _combine_actions(found)
    return found | {("topic", str(action), pattern): (action, pattern) for action, pattern in left}


def _topic_of(topic: DdsTopic, name: Glob) -> tuple[TopicAction, Glob]:
    return topic.action, glob.surround(topic.prefix, name, topic.suffix)


def _name(pattern: Glob, topic: DdsTopic) -> Glob | None:
    """Return the ROS names whose topics a pattern matches; None if it may match others, or there are none."""
    if not glob.prefix(pattern).startswith(f"{topic.prefix}/") or not glob.suffix(pattern).endswith(topic.suffix):
        return None
    text = glob.literal(pattern)
    if text is not None:
        if len(text) <= len(topic.prefix) + len(topic.suffix) + 1:
            return None
        name: Glob = (text[len(topic.prefix) : len(text) - len(topic.suffix)],)
    else:
        last = str(pattern[-1])[: -len(topic.suffix)] if topic.suffix else pattern[-1]
        name = glob.normalise((str(pattern[0])[len(topic.prefix) :], *pattern[1:-1], last))
    return name if matches_ros_name(name) else None


def _combine_actions(found: dict[RosPattern, tuple[TopicAction, Glob]]) -> None:
    """Replace the topics and services of complete actions."""
    made: dict[RosPattern, tuple[TopicAction, Glob]] = {}
    used: set[RosPattern] = set()
    for permission, of_action in _ACTION_PARTS.items():
        (kind, part, ending), *_ = of_action
        for each, source in found.items():
            if each[:2] != (kind, part) or not glob.suffix(each[2]).endswith(ending):
                continue
            *start, last = each[2]
            name = glob.normalise((*start, str(last)[: -len(ending)]))
            needed = {(kind, part, glob.surround("", name, suffix)) for kind, part, suffix in of_action}
            if needed <= found.keys() and matches_ros_name(name):
                made["ros_action", permission, name] = source
                used |= needed
    for each in used:
        del found[each]
    found |= made
