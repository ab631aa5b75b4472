# SPDX-License-Identifier: Apache-2.0
"""Evaluate a policy for one endpoint by its rules; independent of the compiler's translation, to check it.

An endpoint is a raw topic, and may be part of ROS entities; rules that match any of these apply.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.patterns import glob
from comarmor.patterns.glob import matches
from comarmor.rules import Effect, is_fully_qualified, parts
from keymint.api.graph import Edge, Object
from keymint.ir import Rule, SubjectRules
from keymint_ros2_dds.decision import fnmatch_dialects
from keymint_ros2_dds.lowering.endpoints import meanings
from keymint_ros2_dds.lowering.name_mapping import ARDENT
from keymint_ros2_dds.proving import octets


def is_ros_name(name: str) -> bool:
    """Whether a topic or service may have a fully qualified name (ROS 2 design, "Topic and Service Names")."""
    return is_fully_qualified(name) and "__" not in name


def decide(rules: SubjectRules, distro: str, action: str, topic: str, partition: str) -> Rule | None:
    """Return the rule that decides about an endpoint: the first denial, else the first match, else None."""
    edges = endpoint_edges(rules.subject, distro, action, topic, partition)
    about = [rule for rule in rules.rules if any(_is_about(rule, edge, partition) for edge in edges)]
    return next((rule for rule in about if rule.effect is Effect.DENY), about[0] if about else None)


def endpoint_edges(subject: str, distro: str, action: str, topic: str, partition: str) -> tuple[Edge, ...]:
    """Return the edge of an endpoint, and those of the ROS entities that need it."""
    partitions = (partition,) if partition or distro == ARDENT else ()
    endpoint = Edge(subject, action, Object("topic", topic, partitions))
    return (endpoint, *meanings(distro, endpoint))


def _is_about(rule: Rule, edge: Edge, partition: str) -> bool:
    if not _in_partition(rule, edge, partition):
        return False
    return any(_matches(expression, name) for name in _names(rule, edge) for expression in rule.expressions)


def _matches(expression: str, name: str) -> bool:
    """Tell whether an expression matches a name, byte by byte."""
    return matches(octets.of_glob(glob.parse(expression)), fnmatch_dialects.in_bytes(name))


def _names(rule: Rule, edge: Edge) -> Iterator[str]:
    """Yield the names to match against a rule; for a composite rule, without the suffix of its part."""
    for permission in rule.permissions:
        for kind, part, suffix in parts(rule.kind, permission):
            if (kind, part) == (edge.object.kind, edge.permission) and edge.object.name.endswith(suffix):
                yield edge.object.name[: len(edge.object.name) - len(suffix)]


def _in_partition(rule: Rule, edge: Edge, partition: str) -> bool:
    if rule.partitions:
        return any(_matches(expression, partition) for expression in rule.partitions)
    # An edge on a ROS name of Ardent has its partition in its name.
    return rule.effect is Effect.DENY or not any(edge.object.partitions)
