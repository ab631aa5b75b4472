# SPDX-License-Identifier: Apache-2.0
"""Prove that the key expressions of a pattern match exactly the names that the pattern matches."""

from __future__ import annotations

from comarmor.patterns import glob
from comarmor.patterns.decision_lists import BudgetError, ProofResult, SearchBudget, Unknown
from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import cached
from keymint_ros2_zenoh.keyexpr.key_expansion import key_exprs
from keymint_ros2_zenoh.lowering.name_keys import name_key
from keymint_ros2_zenoh.proving.automaton import Automaton
from keymint_ros2_zenoh.proving.key_search import difference, side_of


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
@cached(1 << 14)
def _decided(pattern: Glob, states: int) -> ProofResult:
    automaton = Automaton()
    names = frozenset(automaton.names(0, rest) for rest in glob.after(pattern, "/"))
    keys = frozenset(automaton.key_expr(name_key(0, each)) for each in key_exprs(pattern))
    left, right = (side_of(((nodes, frozenset()),)) for nodes in (names, keys))
    result = difference(automaton, left, right, SearchBudget(states))
    if isinstance(result, Unknown):
        raise BudgetError(result.reason)
    return result
