# SPDX-License-Identifier: Apache-2.0
"""Rules of access control as the compiler makes them from the rules of a subject."""

from __future__ import annotations

from comarmor.errors import Origin
from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint_ros2_zenoh.keyexpr.key_expr import KeyExpr
from keymint_ros2_zenoh.messages import Flow, Message


@dataclass(frozen=True, slots=True)
class KeyRule:
    """What a router must permit or deny on the link of a subject. A denial overrides; what no rule allows is denied.

    Attributes:
        effect: allow or deny.
        messages: messages, in the order of :class:`Message`.
        flows: flows as the router sees them: ingress is from the subject, egress to it.
        key_exprs: key expressions, sorted.
        origin: where the rule is written that it comes from.
    """

    effect: Effect
    messages: tuple[Message, ...]
    flows: tuple[Flow, ...]
    key_exprs: tuple[KeyExpr, ...]
    origin: Origin
