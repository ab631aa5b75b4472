# SPDX-License-Identifier: Apache-2.0
"""Translate patterns of DDS topics back to rules on ROS names: the inverse of :mod:`.lowered_rules`.

A pattern that begins with the prefix of a ROS subsystem is that of a ROS topic; two that are the requests and the
replies of the same services are a rule on services; all parts of an action are a rule on actions. What is incomplete,
and what no ROS name fits, stays a rule on DDS topics. Nothing is lost: each rule means exactly its patterns.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import matches_ros_name
from comarmor.rules import PARTS
from keymint_ros2_dds.lowering.name_mapping import ARDENT, DDS_TOPICS, DdsTopic, TopicAction

RosPattern = tuple[str, str, Glob]
"""Kind, permission and pattern of a rule on names."""
_KINDS = {
    "ros_topic": ("ros_publish", "ros_subscribe", "ros_relay"),
    "ros_service": ("ros_call", "ros_execute"),
}
_ACTIONS = {permission: parts for (kind, permission), parts in PARTS.items() if kind == "ros_action"}


def in_ros(patterns: Iterable[tuple[TopicAction, Glob]], distro: str) -> Mapping[RosPattern, tuple[TopicAction, Glob]]:
    """Return rules for patterns of DDS topics in the default partition, each with a pattern that it stands for.

    Args:
        patterns: what may be done, and to which topics; all allowed, or all denied.
        distro: ROS 2 distribution whose name mapping applies; Ardent's puts names into partitions.
    """
    left = dict.fromkeys(patterns)
    found: dict[RosPattern, tuple[TopicAction, Glob]] = {}
    if distro != ARDENT:
        for kind, permissions in _KINDS.items():
            for permission in permissions:
                topics = DDS_TOPICS[permission]
                found |= {(kind, permission, name): _of(topics[0], name) for name in _complete(topics, left)}
        for _, permission, name in found:
            for topic in DDS_TOPICS[permission]:
                left.pop(_of(topic, name), None)
        _combine_actions(found)
    return found | {("topic", str(action), pattern): (action, pattern) for action, pattern in left}


def _of(topic: DdsTopic, name: Glob) -> tuple[TopicAction, Glob]:
    return topic.action, glob.surround(topic.prefix, name, topic.suffix)


def _complete(topics: tuple[DdsTopic, ...], patterns: Mapping[tuple[TopicAction, Glob], None]) -> list[Glob]:
    """Return the patterns of ROS names for which there are all topics of a permission."""
    names = (_name(pattern, topics[0]) for action, pattern in patterns if action is topics[0].action)
    return [name for name in names if name is not None and all(_of(topic, name) in patterns for topic in topics)]


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
    for permission, parts in _ACTIONS.items():
        (kind, part, ending), *_ = parts
        for each, source in found.items():
            if each[:2] != (kind, part) or not glob.suffix(each[2]).endswith(ending):
                continue
            *start, last = each[2]
            name = glob.normalise((*start, str(last)[: -len(ending)]))
            needed = {(kind, part, glob.surround("", name, suffix)) for kind, part, suffix in parts}
            if needed <= found.keys() and matches_ros_name(name):
                made["ros_action", permission, name] = source
                used |= needed
    for each in used:
        del found[each]
    found |= made
