# SPDX-License-Identifier: Apache-2.0
"""Mapping of ROS names to DDS topics and partitions, by ROS 2 distribution.

Since Bouncy the full ROS name is part of the topic name, and partitions are not used: the topic ``/a`` is the DDS topic
``rt/a``; the service ``/s`` is the pair ``rq/sRequest`` and ``rr/sReply``. :mod:`.ardent_names` is the mapping of
Ardent. Actions and parameters consist of topics and services. Raw topics keep their names.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from comarmor.errors import Origin
from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect
from comarmor.text import did_you_mean
from keymint.errors import KeymintError
from keymint_ros2_dds.lowering import ardent_names
from keymint_ros2_dds.lowering.dds_topics import DdsTopic

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
        pairs = ardent_names.dds_patterns(expression, topic, part, every=effect is Effect.DENY)
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
