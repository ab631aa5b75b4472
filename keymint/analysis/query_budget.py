"""What a whole command may spend on questions: states, whichever question visits them."""

from __future__ import annotations

from dataclasses import dataclass, field

from comarmor.patterns.decision_lists import SearchBudget

STATES = 5_000_000
"""States that all questions of a command may visit together."""
QUESTION = 50_000
"""States that one question may visit."""
_STARTS = 4
"""How often a question calls it before an engine can have visited 256 states."""
_FEW = 16
"""States that such a call counts for."""
_TICK = 256
"""States that an engine visits between two calls of :attr:`comarmor.patterns.decision_lists.SearchBudget.go_on`."""


@dataclass(slots=True)
class QueryBudget:
    """A budget that several questions share.

    Attributes:
        states: states that they may visit together; each engine of each question counts for at least 16.
        spent: states that they visited.
    """

    states: int = STATES
    spent: int = field(default=0, init=False)

    def question(self, lists: int = 1) -> SearchBudget:
        """Return the budget of the next question: of so many lists, of which a state holds each."""
        calls = 0

        def go_on() -> bool:
            nonlocal calls
            calls += 1
            return self.spend(lists * (_FEW if calls <= _STARTS else _TICK))

        return SearchBudget(max(1, min(QUESTION // lists, self.states - self.spent)), go_on)

    def spend(self, states: int) -> bool:
        """Count states; tell whether any are left."""
        self.spent += states
        return not self.is_empty

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left."""
        return self.spent >= self.states

    def reason(self, found: str) -> str:
        """Return why a question was not decided: the shared budget is spent, or its own is, as it says.

        A question that spent its own counts in full: it may have ended by its steps, of which a state takes many.
        """
        self.spend(QUESTION)
        return f"the budget of {self.states:,} states is spent" if self.is_empty else found
