"""ROS names as DDS topics since ROS 2 Bouncy: the full ROS name is part of the topic name, partitions are not used.

The topic ``/a`` is the DDS topic ``rt/a``; the service ``/s`` is the pair ``rq/sRequest`` and ``rr/sReply``. Actions
and parameters consist of topics and services.
"""

from __future__ import annotations

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from keymint_ros2_dds.lowering.dds_topics import DdsTopic


def dds_patterns(expression: Glob, topic: DdsTopic, part: str = "") -> tuple[Glob, ...]:
    """Return patterns that match exactly the DDS names of the ROS names that an expression matches.

    A ROS name begins with ``/``. So ``*/scan`` becomes ``rt/scan`` and ``rt/*/scan``, not ``rt*/scan``.

    Args:
        expression: an expression over ROS names, or over DDS names for a topic without a prefix.
        topic: the DDS topic that the names map to.
        part: the part of a composite that follows the names, e.g. ``/_action/status``.
    """
    if not topic.prefix:
        return (glob.surround("", expression, topic.suffix),)
    text = glob.literal(expression)
    if text is not None:
        name = text + part
        return ((topic.prefix + name + topic.suffix,),) if name.startswith("/") else ()
    after = glob.after(glob.surround("", expression, part), "/")
    return tuple(glob.surround(topic.prefix + "/", rest, topic.suffix) for rest in after)
