# SPDX-License-Identifier: Apache-2.0
"""The decision on an edge, from the decisions on its messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from keymint.api import Verdict
from keymint_ros2_zenoh.decision.operations import Operation, Request

NAMELESS = Verdict(allowed=False, reason="no key of Zenoh can have this name")


def edge_verdict(
    operations: Sequence[Operation], decide: Callable[[Request], Verdict], at_router: Callable[[Request], Verdict]
) -> Verdict:
    """Return the decision on an edge.

    It is allowed if all messages of all operations are. It is allowed in part if not, but the router permits the
    messages of one of the ways to do an operation: a session need not keep to the conventions of ROS, nor to its own
    access control.

    Args:
        operations: the operations of the edge; none if no key can have its name.
        decide: decides on a message at the router and at the session's own access control.
        at_router: decides on a message at the router alone.
    """
    first: Verdict | None = None
    denied: dict[Operation, tuple[Request, Verdict]] = {}
    for operation in operations:
        for request in operation.requests:
            verdict = decide(request)
            first = first or verdict
            if not verdict.allowed:
                denied[operation] = request, verdict
                break
    if not denied:
        return first or NAMELESS
    missing, denial = next(iter(denied.values()))
    for operation in denied:  # one that is whole may be permitted for its own sake: the edge is composite
        for way in operation.ways:
            permitted = [at_router(request) for request in way]
            if all(verdict.allowed for verdict in permitted):
                reason = f"in part: {permitted[0].reason}; but {denial.reason}"
                # If the router permits all, the session's own file is the one to look at.
                where = denial.where if at_router(missing).allowed else permitted[0].where
                return Verdict(allowed=False, reason=reason, where=where, partial=True)
    return denial
