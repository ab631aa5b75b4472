# SPDX-License-Identifier: Apache-2.0
"""The rules of an enclave, as its policy reads: the union of its nodes, in which any DENY overrides every ALLOW."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.rules import Effect, Rule
from keymint_ros2_sros2.names import as_read, expression
from keymint_ros2_sros2.syntax import KINDS, RosNode, RuleList, Sros2Enclave

GRAPH_TOPIC = "ros_discovery_info"
"""The topic by which participants tell each other their nodes. From Foxy on SROS2 allows it to every enclave."""


def rules_of(enclaves: Iterable[Sros2Enclave], *, graph: bool) -> tuple[Rule, ...]:
    """Return the rules of the enclaves of one path.

    Args:
        enclaves: the enclaves.
        graph: with the rule that SROS2 adds by itself (:attr:`~keymint_ros2_sros2.syntax.SourcePolicy.has_graph`).

    Raises:
        ComArmorError: a name is not an expression, with ``file:line``.
    """
    found: list[Rule] = []
    for enclave in enclaves:
        for node in enclave.nodes():
            found += (rule for rules in node.lists for rule in _of_list(node, rules))
        if graph:
            permissions = ("publish", "subscribe")
            found.append(Rule(Effect.ALLOW, "topic", permissions, (GRAPH_TOPIC,), (), False, enclave.where))
    return tuple(found)


def _of_list(node: RosNode, rules: RuleList) -> Iterator[Rule]:
    names = tuple(dict.fromkeys(expression(as_read(node, entry.text), entry) for entry in rules.entries))
    for effect in Effect:
        permissions = tuple(permission for permission, given in rules.effects.items() if given is effect)
        if permissions and names:
            yield Rule(effect, KINDS[rules.tag], permissions, names, (), False, rules.where)
