# SPDX-License-Identifier: Apache-2.0
"""A budget of search states shared by all queries of a command."""

from __future__ import annotations

from dataclasses import field

from comarmor.patterns.decision_lists import ProofResult, SearchBudget, Unknown, Witness
from comarmor.values import dataclass

STATES = 5_000_000
"""Maximum number of states for all queries of a command."""
QUERY = 50_000
"""Maximum number of states for one query."""
_STARTS = 4
"""Calls of a query before an engine can have visited 256 states."""
_FEW = 16
"""States counted for each of these calls."""
_TICK = 256
"""States that an engine visits between two calls of :attr:`comarmor.patterns.decision_lists.SearchBudget.go_on`."""


@dataclass(slots=True)
class QueryBudget:
    """A budget shared by several queries.

    Attributes:
        states: maximum number of states; each engine of each query counts for at least 16.
        spent: number of visited states.
    """

    states: int = STATES
    spent: int = field(default=0, init=False)

    def next_query(self, lists: int = 1) -> SearchBudget:
        """Return the budget of the next query; a state counts once for each decision list."""
        calls = 0

        def go_on() -> bool:
            nonlocal calls
            calls += 1
            return self.spend(lists * (_FEW if calls <= _STARTS else _TICK))

        return SearchBudget(max(1, min(QUERY // lists, self.states - self.spent)), go_on)

    def spend(self, states: int) -> bool:
        """Count states; return True if any are left."""
        self.spent += states
        return not self.is_empty

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left."""
        return self.spent >= self.states

    def verdict(self, outcome: ProofResult) -> bool | Unknown:
        """Return whether a query found a word, or why it was not decided."""
        if isinstance(outcome, Unknown):
            return Unknown(self.reason(outcome.reason))
        return isinstance(outcome, Witness)

    def reason(self, own: str) -> str:
        """Return why a query was not decided: the shared budget is spent, or the reason of the query itself.

        An undecided query counts in full: it may have ended at its limit of steps, and a state takes many steps.
        """
        self.spend(QUERY)
        return f"the budget of {self.states:,} states is spent" if self.is_empty else own
