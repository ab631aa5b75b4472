"""The questions: equality, implication, intersection, shadowing; each exact, or unknown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

from comarmor.patterns import fast_path
from comarmor.patterns.counterexample_search import CounterexampleSearch
from comarmor.patterns.decision_lists import (
    EVERY_WORD,
    Block,
    BudgetError,
    DecisionList,
    Equal,
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
)
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import permits
from comarmor.patterns.glob import Glob
from comarmor.patterns.product_search import ProductSearch
from comarmor.patterns.steps import StepLimitError, step_limit

FIRST_RUNG = 5_000
PER_PATTERN = 20
"""States that the first engine may visit before the second one is asked: so many, and so many for each pattern."""
STEP = 10
"""By how much both may visit more, when neither has decided."""
HEAVIER = 50
"""A state of the second engine holds all lists at once, and costs as much as so many of the first one."""


def difference(
    a: DecisionList, *b: DecisionList, universe: Universe = EVERY_WORD, budget: SearchBudget | None = None
) -> ProofResult:
    """Tell whether a list permits exactly the words that another one (of several: all the others) permits.

    Args:
        a: a list.
        b: lists; together they permit what every one of them permits.
        universe: the words in question.
        budget: what the answer may cost.

    Returns:
        :class:`Equal`, a shortest :class:`Witness`, or :class:`Unknown` when the budget was spent.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: _difference(a, b, universe, budget))


def _within(budget: SearchBudget, ask: Callable[[], ProofResult]) -> ProofResult:
    """Ask a question that may take the steps of a budget, or those that are left around it."""
    try:
        with step_limit(budget.steps):
            return ask()
    except StepLimitError as spent:
        return Unknown(str(spent))


def _difference(a: DecisionList, b: Sequence[DecisionList], universe: Universe, budget: SearchBudget) -> ProofResult:
    if fast_path.equal(a, b, universe):
        return Equal()
    arena = cache(lambda: Derivatives(_patterns((a, *b)), universe))
    spent = ""
    patterns = sum(len(block.patterns) for decisions in (a, *b) for block in decisions)
    for first, second in _rungs(budget, FIRST_RUNG + PER_PATTERN * patterns):
        try:
            word = _by_cubes(a, b, universe, arena, first)
        except BudgetError as error:
            spent = str(error)
        else:
            return Equal() if word is None else _judged(a, b, word)
        try:
            word = ProductSearch(b, a, universe, arena(), second.meter()).shortest()
        except BudgetError:
            continue
        return Equal() if word is None else _judged(a, b, word)
    return Unknown(spent)


def _rungs(budget: SearchBudget, states: int) -> Iterator[tuple[SearchBudget, SearchBudget]]:
    """Yield what each engine may spend in turn: what is hard for one is often easy for the other."""
    while states < budget.states and budget.go_on():
        yield replace(budget, states=states), replace(budget, states=max(1, states // HEAVIER))
        states *= STEP
    yield budget, budget


def implies(
    a: DecisionList, b: DecisionList, universe: Universe = EVERY_WORD, budget: SearchBudget | None = None
) -> ProofResult:
    """Tell whether every word that a list permits is permitted by another one, too.

    Returns:
        :class:`Equal` if so; else a shortest :class:`Witness` that ``a`` permits and ``b`` does not, or
        :class:`Unknown`.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: Equal() if fast_path.implied(a, b, universe) else _escape((a,), b, universe, budget))


def intersects(
    a: DecisionList, b: DecisionList, universe: Universe = EVERY_WORD, budget: SearchBudget | None = None
) -> ProofResult:
    """Tell whether there is a word that both lists permit.

    Returns:
        a shortest :class:`Witness` if so; else :class:`Equal` (there is none), or :class:`Unknown`.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: _escape((a, b), (), universe, budget))


def shadowed(
    decisions: DecisionList, universe: Universe = EVERY_WORD, budget: SearchBudget | None = None
) -> Iterator[tuple[int, int, ProofResult]]:
    """Tell, for each pattern, whether the patterns before it match all that it matches.

    Patterns of the same block that come earlier count as well.

    Yields:
        number of the block, number of the pattern in it, and :class:`Equal` if it is shadowed; else a shortest
        :class:`Witness` of what it alone decides, or :class:`Unknown`.
    """
    budget = budget or SearchBudget()
    before: dict[Glob, None] = {}
    for at, block in enumerate(decisions):
        for number, pattern in enumerate(block.patterns):
            yield at, number, _within(budget, partial(_beyond, pattern, tuple(before), universe, budget))
            before[pattern] = None


def escapes(
    permitting: Sequence[DecisionList],
    refusing: DecisionList,
    universe: Universe = EVERY_WORD,
    budget: SearchBudget | None = None,
) -> ProofResult:
    """Tell whether every word that all of some lists permit is permitted by another one, too.

    Returns:
        :class:`Equal` if so; else a shortest :class:`Witness` that they permit and the other refuses, or
        :class:`Unknown`.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: _escape(permitting, refusing, universe, budget))


def _beyond(pattern: Glob, before: tuple[Glob, ...], universe: Universe, budget: SearchBudget) -> ProofResult:
    """Look for a word that a pattern matches, and none of those before it."""
    return _escape(((Block(True, (pattern,)),),), (Block(True, before),), universe, budget)


def _escape(
    permitting: Sequence[DecisionList], refusing: DecisionList, universe: Universe, budget: SearchBudget
) -> ProofResult:
    arena = cache(lambda: Derivatives(_patterns((*permitting, refusing)), universe))
    try:
        word = CounterexampleSearch(permitting, refusing, universe, arena, budget.meter()).shortest()
    except BudgetError as spent:
        return Unknown(str(spent))
    if word is None:
        return Equal()
    if not all(permits(each, word) for each in permitting) or permits(refusing, word):
        raise AssertionError(f"the word {word!r} is not what was looked for")
    return Witness(word, left=True)


def _by_cubes(
    a: DecisionList,
    b: Sequence[DecisionList],
    universe: Universe,
    arena: Callable[[], Derivatives],
    budget: SearchBudget,
) -> str | None:
    """Return the shortest word on which a list differs from several others together."""
    meter = budget.meter()
    best: str | None = None
    for each in b:
        found = CounterexampleSearch((a,), each, universe, arena, meter).shortest(_length(best))
        best = best if found is None else found
    more = CounterexampleSearch(b[:1], a, universe, arena, meter).shortest(_length(best))
    if more is not None and not all(permits(each, more) for each in b[1:]):
        more = CounterexampleSearch(b, a, universe, arena, meter).shortest(_length(best))
    return best if more is None else more


def _length(word: str | None) -> int | None:
    return None if word is None else len(word)


def _judged(a: DecisionList, b: Sequence[DecisionList], word: str) -> Witness:
    """Judge a word by plain evaluation: what an engine says is not taken on trust."""
    left = permits(a, word)
    if left is all(permits(each, word) for each in b):
        raise AssertionError(f"the lists do not differ on {word!r}")
    return Witness(word, left)


def _patterns(lists: Sequence[DecisionList]) -> Iterator[Glob]:
    return (pattern for decisions in lists for block in decisions for pattern in block.patterns)
