# SPDX-License-Identifier: Apache-2.0
"""What a policy permits a subject, as patterns of keys for each message and flow.

That the key expressions of a pattern match exactly the names that the pattern matches is proven here too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.patterns import glob
from comarmor.patterns.decision_lists import BudgetError, Equal, ProofResult, SearchBudget, Unknown
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import step_counting_cache
from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint_ros2_zenoh.decision import KeyLists
from keymint_ros2_zenoh.documents.configuration import Flow, Message
from keymint_ros2_zenoh.keyexpr import KeyExpr, key_exprs
from keymint_ros2_zenoh.lowering.key_rules import slot_rules
from keymint_ros2_zenoh.lowering.name_rules import NameRules
from keymint_ros2_zenoh.lowering.permissions import GRAPH_SLOTS, USERS, Place, Slot, graph_key, name_key, own_tokens_key
from keymint_ros2_zenoh.proving.key_search import Automaton, difference, side_of


@dataclass(frozen=True, slots=True)
class PolicySide:
    """The rights of a subject by its policy.

    Attributes:
        names: its rules by permission.
        domains: the ids of its domains.
    """

    names: NameRules
    domains: tuple[int, ...]

    def permitted(self, message: Message, flow: Flow) -> KeyLists:
        """Return what the policy permits: an entry for each permission that needs the message on data.

        What is permitted beside data and for the graph is part of the first entry: no key belongs to two of these, so
        that a denial of one concerns no other.
        """
        data, beside = ([*self._of(Slot(message, flow, place))] for place in (Place.DATA, Place.ADVANCED))
        (allowed, denied), *others = data or [((), ())]
        for more_allowed, more_denied in beside:
            allowed, denied = (*allowed, *more_allowed), (*denied, *more_denied)
        return ((*allowed, *self._graph(message, flow)), denied), *others

    def _of(self, slot: Slot) -> Iterator[tuple[tuple[KeyExpr, ...], tuple[KeyExpr, ...]]]:
        for permission in sorted(USERS[slot]):
            allowed, denied = (self.names.patterns(effect, permission) for effect in (Effect.ALLOW, Effect.DENY))
            yield self._keys(slot.place, allowed), self._keys(slot.place, denied)

    def expressible(self, message: Message, flow: Flow) -> KeyLists:
        """Return what one list of denials can express: where permissions share a message, more than :meth:`permitted`.

        It permits a reply on names that one permission is denied and another one is allowed on other names of the same
        rule; see :data:`keymint_ros2_zenoh.lowering.permissions.SLOTS` for why this is no right.
        """
        lists: dict[Effect, list[KeyExpr]] = {effect: [] for effect in Effect}
        for effect, slots, pattern, _ in slot_rules(self.names):
            for slot in slots:
                if (slot.message, slot.flow) == (message, flow):
                    lists[effect] += self._keys(slot.place, (pattern,))
        lists[Effect.ALLOW] += self._graph(message, flow)
        return ((tuple(lists[Effect.ALLOW]), tuple(lists[Effect.DENY])),)

    def unproven(self, states: int) -> str:
        """Return why the key expressions of a pattern are not proven to match the same names; empty if all are."""
        for pattern in dict.fromkeys(each.pattern for each in self.names.rules):
            result = proven_exact(pattern, states)
            if result != Equal():
                return f"the key expressions of {exact(pattern)!r} are not proven to match the same names: {result}"
        return ""

    def _keys(self, place: Place, patterns: Sequence[Glob]) -> tuple[KeyExpr, ...]:
        return tuple(
            name_key(domain, name, place)
            for pattern in patterns
            for name in key_exprs(pattern)
            for domain in self.domains
        )

    def _graph(self, message: Message, flow: Flow) -> Iterator[KeyExpr]:
        for domain in self.domains:
            if (message, flow) == (Message.LIVELINESS_TOKEN, Flow.INGRESS):
                yield own_tokens_key(domain, self.names.subject)
            if (message, flow) in GRAPH_SLOTS:
                yield graph_key(domain)


def proven_exact(pattern: Glob, states: int) -> ProofResult:
    """Compare a pattern of ROS names with its key expressions, as keys of domain 0 with any type and hash.

    Args:
        pattern: pattern of names.
        states: the most states that the search may visit.
    """
    try:
        return _decided(pattern, states)
    except BudgetError as error:
        return Unknown(str(error))


# Many enclaves have the same patterns. What is unknown is not cached: it may depend on an outer limit.
@step_counting_cache(1 << 14)
def _decided(pattern: Glob, states: int) -> ProofResult:
    automaton = Automaton()
    names = frozenset(automaton.names(0, rest) for rest in glob.left_quotient(pattern, "/"))
    keys = frozenset(automaton.key_expr(name_key(0, each)) for each in key_exprs(pattern))
    left, right = (side_of(((nodes, frozenset()),)) for nodes in (names, keys))
    result = difference(automaton, left, right, SearchBudget(states))
    if isinstance(result, Unknown):
        raise BudgetError(result.reason)
    return result
