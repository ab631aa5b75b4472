"""What a whole command may spend on questions: states, whichever question visits them."""

from __future__ import annotations

from dataclasses import dataclass, field

from keymint.proof import Budget

STATES = 5_000_000
"""States that all questions of a command may visit together."""
QUESTION = 50_000
"""States that one question may visit."""
_TICK = 256
"""States that an engine visits between two calls of :attr:`keymint.proof.Budget.go_on`."""


@dataclass(slots=True)
class Purse:
    """A budget that several questions share.

    Attributes:
        states: states that they may visit together; each engine of each question counts for at least 256.
        spent: states that they visited.
    """

    states: int = STATES
    spent: int = field(default=0, init=False)

    def question(self, lists: int = 1) -> Budget:
        """Return the budget of the next question: of so many lists, of which a state holds each."""
        return Budget(max(1, min(QUESTION // lists, self.states - self.spent)), lambda: self.spend(_TICK * lists))

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
