# SPDX-License-Identifier: Apache-2.0
"""Decision lists, the words that a question covers, and the answers."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

from comarmor.patterns.glob import EVERYTHING, Glob
from comarmor.patterns.steps import StepLimitError, spend, step_limit
from comarmor.patterns.tokens import ANY, Charset
from comarmor.values import Data, field


class Block(Data):
    """A step of a decision list: it permits or denies the words that any of its patterns matches.

    Attributes:
        allows: whether it permits them.
        patterns: patterns.
    """

    allows: bool
    patterns: tuple[Glob, ...]


DecisionList = tuple[Block, ...]
"""The first block that matches a word decides; a word that no block matches is denied."""


def negate(decisions: DecisionList) -> DecisionList:
    """Return the list that permits exactly what another one denies."""
    return (*(Block(not block.allows, block.patterns) for block in decisions), Block(True, (EVERYTHING,)))


class Universe(Data):
    """The words that a question covers: a fixed number of fields, with a separator between them.

    A pattern over words of two fields contains the separator once. Its wildcards cannot match the separator, because
    every word has it only once.

    Attributes:
        alphabet: the characters of a field.
        fields: number of fields, at least one.
        separator: a character outside of the alphabet; needed for several fields.
        last_nonempty: the last field has at least one character.
    """

    alphabet: Charset
    fields: int = 1
    separator: str = "\0"
    last_nonempty: bool = False

    def __contains__(self, word: str) -> bool:
        """Return whether a word belongs to the universe."""
        return _regex(self).fullmatch(word) is not None


@lru_cache(maxsize=64)
def _regex(universe: Universe) -> re.Pattern[str]:
    characters = "".join(rf"\U{low:08x}-\U{high:08x}" for low, high in universe.alphabet.ranges)
    fields = [f"[{characters}]*"] * universe.fields
    if universe.last_nonempty:
        fields[-1] = f"[{characters}]+"
    return re.compile(re.escape(universe.separator).join(fields))


EVERY_WORD = Universe(ANY)
"""All strings."""


class Equal(Data):
    """The lists decide every word of the universe the same way; of other questions: there is no such word."""


class Witness(Data):
    """A shortest word on which the lists differ; of other questions: a shortest such word.

    Attributes:
        word: the word.
        left: whether the first list permits it; the second decides otherwise.
    """

    word: str
    left: bool


class Unknown(Data):
    """The budget was spent before the question was decided.

    Attributes:
        reason: which budget.
    """

    reason: str


ProofResult = Equal | Witness | Unknown


FAST_PATH_STEPS = 200_000
"""Steps of a question besides those of its search."""


class BudgetError(Exception):
    """The budget of a question is spent; the message tells which."""


class SearchBudget(Data, frozen=False):
    """The cost that a question may have.

    Attributes:
        states: states that each of the two engines may visit.
        go_on: called repeatedly; the search gives up when it returns False. Callers that may read the clock use it as a
            deadline.
        steps_per_state: steps (:mod:`comarmor.patterns.steps`) that a state may cost on average; the fast path may take
            :data:`FAST_PATH_STEPS` besides.
    """

    states: int = 500_000
    go_on: Callable[[], bool] = field(default=lambda: True)
    steps_per_state: int = 100

    @property
    def steps(self) -> int:
        """Step limit of the question."""
        return FAST_PATH_STEPS + self.states * self.steps_per_state

    def answer(self, search: Callable[[], str | None], sides: Callable[[str], tuple[bool, bool]]) -> ProofResult:
        """Answer a question within the step limit of the budget, or an outer one.

        Args:
            search: returns a shortest word on which the sides differ, or None.
            sides: decides a word on both sides, by definition: counterexamples are checked with it.
        """
        try:
            with step_limit(self.steps):
                word = search()
        except (BudgetError, StepLimitError) as error:
            return Unknown(str(error))
        if word is None:
            return Equal()
        left, right = sides(word)
        if left is right:
            raise AssertionError(f"the word {word!r} is no counterexample")
        return Witness(word, left)

    def state_counter(self) -> Callable[[], None]:
        """Return a function to call for every state; it raises :class:`BudgetError` when the budget is spent."""
        visited = 0

        def count() -> None:
            nonlocal visited
            if visited >= self.states:
                raise BudgetError(f"not decided within {self.states:,} states")
            if not visited % 256 and not self.go_on():
                raise BudgetError("not decided in time")
            visited += 1
            spend()

        return count
