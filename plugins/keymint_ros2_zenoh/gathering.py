# SPDX-License-Identifier: Apache-2.0
"""Fewer rules with the same meaning: those for the same messages in the same flows become one."""

from __future__ import annotations

from collections.abc import Iterable

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint_ros2_zenoh.keyexpr.key_expansion import maximal
from keymint_ros2_zenoh.keyexpr.key_expr import KeyExpr
from keymint_ros2_zenoh.lowering.key_rule import KeyRule
from keymint_ros2_zenoh.messages import Flow, Message


def gathered(rules: Iterable[KeyRule]) -> tuple[KeyRule, ...]:
    """Return rules that decide every message and key expression as the given ones do.

    The order of rules has no meaning, and a rule applies if one of its key expressions includes the key. So rules of
    the same effect, messages and flows are one rule with all their key expressions. One that another includes is left
    out.
    """
    groups: dict[tuple[Effect, tuple[Message, ...], tuple[Flow, ...]], tuple[Origin, set[KeyExpr]]] = {}
    for rule in rules:
        _, keys = groups.setdefault((rule.effect, rule.messages, rule.flows), (rule.origin, set()))
        keys.update(rule.key_exprs)
    return tuple(
        KeyRule(effect, messages, flows, maximal(keys), origin)
        for (effect, messages, flows), (origin, keys) in groups.items()
    )
