# SPDX-License-Identifier: Apache-2.0
"""Names of nodes that have a part which is made at run time, and names that may have one."""

from __future__ import annotations

import re
from collections.abc import Iterator

from comarmor.errors import Diagnostic
from comarmor.regex import lazy_regex
from keymint.api.graph import Edge, Graph

NAMES_DIFFER = "names-differ"
"""Code of a note on names that two records have in different forms."""
GENERATED = (
    ("transform_listener_impl_", "[0-9a-f]+", "the address of a listener of tf2_ros"),
    ("_ros2cli_daemon_[0-9]+_", "[0-9a-f]+", "a number of the daemon of 'ros2'"),
    ("_ros2cli_", "[0-9]+", "the process id of a command 'ros2'"),
    ("launch_ros_", "[0-9]+", "the process id of 'ros2 launch'"),
    ("moveit_", "[0-9]+", "a number of MoveIt"),
)
"""Known names of nodes: the expression of what stays, that of what changes with each start, and what the latter is.

tf2_ros, ``transform_listener.cpp``; ros2cli, ``node/direct.py`` and ``daemon``; launch_ros, ``ros_adapters.py``. Names
that follow from others, like ``controller_server_rclcpp_node`` of Nav2, are no such names.
"""
_FORMS = "|".join(f"(?P<kept{at}>{kept}){made}" for at, (kept, made, _) in enumerate(GENERATED))
_KNOWN = lazy_regex(f"(?<![^/])(?:{_FORMS})(?=/)")
_MAYBE = lazy_regex(r"(?<=_)(?=[A-Za-z]*[0-9])[A-Za-z0-9]+(?![A-Za-z0-9])|(?<=[A-Za-z])[0-9]+(?=/|\Z)")
"""A part of a name with a digit: between ``_``, or the digits that a segment ends with."""


def generalised(text: str, kind: str) -> tuple[str, str]:
    """Return an expression of a name in which ``*`` stands for the parts that are made at run time, and what these are.

    Args:
        text: the name, or an expression of it; from the beginning of a segment on.
        kind: kind of the object; parameters have the name of their node.
    """
    whole = kind == "ros_parameter"
    found: list[str] = []

    def kept(match: re.Match[str]) -> str:
        at = next(at for at in range(len(GENERATED)) if match[f"kept{at}"] is not None)
        found.append(GENERATED[at][2])
        return f"{match[f'kept{at}']}*"

    expression = _KNOWN.sub(kept, f"{text}/" if whole else text)
    return expression[:-1] if whole else expression, ", ".join(dict.fromkeys(found))


def is_generated(node: str) -> bool:
    """Tell whether the name of a node has a part that is made at run time."""
    return bool(generalised(node, "ros_parameter")[1])


def differing(one: Graph, other: Graph) -> Iterator[Diagnostic]:
    """Yield a note for names that only one of two records has, where a part with a digit may change at each start.

    Nothing follows from it: ``/arm_1`` and ``/arm_2`` may be two arms.
    """
    before, now = ({_named(edge) for edge in graph.edges} for graph in (one, other))
    gone: dict[tuple[str, ...], str] = {}
    for *rest, name in sorted(before - now):
        gone |= {(*rest, pattern): name for pattern in _patterns(name)}
    told: set[str] = set()
    for *rest, name in sorted(now - before):
        for pattern in _patterns(name):
            earlier = gone.get((*rest, pattern))
            if earlier is not None and pattern not in told:
                told.add(pattern)
                message = f"{earlier} in one record, {name} in another: is a part of this name made at each start?"
                yield Diagnostic.note(NAMES_DIFFER, message, None, f"then write {pattern} in the policy", rest[0])


def _named(edge: Edge) -> tuple[str, str, str, str]:
    return edge.subject, edge.object.kind, edge.permission, generalised(edge.object.name, edge.object.kind)[0]


def _patterns(name: str) -> Iterator[str]:
    return (f"{name[: part.start()]}*{name[part.end() :]}" for part in _MAYBE.finditer(name))
