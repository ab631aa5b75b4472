"""Names since ROS 2 Bouncy: the whole ROS name is part of the DDS topic's, and partitions are not used.

A topic ``/a`` is the DDS topic ``rt/a``; a service ``/s`` is the pair ``rq/sRequest`` and ``rr/sReply``; actions and
parameters are made of these.
"""

from __future__ import annotations

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from keymint_ros2_dds.lowering.entities import Image


def image(expression: Glob, mapped: Image, part: str = "") -> tuple[Glob, ...]:
    """Return globs for exactly the DDS names of the ROS names that an expression matches.

    A ROS name begins with ``/``. What is left of the expression after that ``/`` says how the name goes on, so
    ``*/scan`` has the images ``rt/scan`` and ``rt/*/scan``, and not ``rt*/scan``.

    Args:
        expression: an expression over ROS names, or over DDS names for an image without a prefix.
        mapped: where the names go.
        part: the part of a composite that follows the names, e.g. ``/_action/status``.
    """
    if not mapped.prefix:
        return (glob.surround("", expression, mapped.suffix),)
    text = glob.literal(expression)
    if text is not None:
        name = text + part
        return ((mapped.prefix + name + mapped.suffix,),) if name.startswith("/") else ()
    after = glob.after(glob.surround("", expression, part), "/")
    return tuple(glob.surround(mapped.prefix + "/", rest, mapped.suffix) for rest in after)
