"""What is asked, and what is answered."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import spend
from comarmor.patterns.tokens import ANY, Charset


@dataclass(frozen=True, slots=True)
class Block:
    """A step of a decision list: a word that any of the patterns matches is permitted, or refused.

    Attributes:
        allows: what the step does with what it matches.
        patterns: expressions; see :mod:`comarmor.patterns.glob`.
    """

    allows: bool
    patterns: tuple[Glob, ...]


DecisionList = tuple[Block, ...]
"""Steps of which the first that matches a word decides; a word that none matches is refused."""


@dataclass(frozen=True, slots=True)
class Universe:
    """The words that a question is about: so many fields, with a separator between them.

    A pattern over words of two fields has the separator once; its wildcards cannot match the separator then, since
    every word has it once only.

    Attributes:
        alphabet: the characters of a field.
        fields: how many fields a word has, at least one.
        separator: a character outside of the alphabet; needed when there are several fields.
        last_nonempty: the last field of a word has at least one character.
    """

    alphabet: Charset
    fields: int = 1
    separator: str = "\0"
    last_nonempty: bool = False

    def __contains__(self, word: str) -> bool:
        """Tell whether a word is one of the universe."""
        return _form(self).fullmatch(word) is not None


@lru_cache(maxsize=64)
def _form(universe: Universe) -> re.Pattern[str]:
    field_ = "".join(rf"\U{low:08x}-\U{high:08x}" for low, high in universe.alphabet.ranges)
    fields = [f"[{field_}]*"] * universe.fields
    if universe.last_nonempty:
        fields[-1] = f"[{field_}]+"
    return re.compile(re.escape(universe.separator).join(fields))


EVERY_WORD = Universe(ANY)
"""All strings."""
PRINTABLE = Universe(Charset(((0x20, 0x7E),)))
"""All strings of printable ASCII."""


@dataclass(frozen=True, slots=True)
class Equal:
    """Both decide alike on every word of the universe (or: there is no word as was asked for)."""


@dataclass(frozen=True, slots=True)
class Witness:
    """A word as was asked for, and none is shorter.

    Attributes:
        word: the word.
        left: what the first decides about it: the second decides otherwise.
    """

    word: str
    left: bool


@dataclass(frozen=True, slots=True)
class Unknown:
    """The budget was spent before an answer was found; says which."""

    reason: str


ProofResult = Equal | Witness | Unknown


FAST_PATH_STEPS = 200_000
"""Steps for what is seen of a question before it is searched."""


class BudgetError(Exception):
    """The budget of a question is spent; says which."""


@dataclass(slots=True)
class SearchBudget:
    """How much a question may cost.

    Attributes:
        states: states that each of the two engines may visit.
        go_on: asked again and again; when it returns False the question is given up. Callers that may read the clock
            make it a deadline.
        steps_per_state: a state of many patterns takes many steps (:mod:`comarmor.patterns.steps`); on average it may
            take so many. :data:`FAST_PATH_STEPS` more are for what shows without a search.
    """

    states: int = 500_000
    go_on: Callable[[], bool] = field(default=lambda: True)
    steps_per_state: int = 100

    @property
    def steps(self) -> int:
        """Steps that the whole question may take, with both engines."""
        return FAST_PATH_STEPS + self.states * self.steps_per_state

    def meter(self) -> Callable[[], None]:
        """Return a function to be called for every state.

        It raises :class:`BudgetError` when the budget is spent.
        """
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
