"""Effort, counted in steps, so that every search ends: on every machine after the same steps, whatever the time.

A step is a pair of patterns compared, or a state visited. Whoever starts work says how much it may cost
(:func:`step_limit`), and what works counts what it does (:func:`spend`). Where the steps are spent
:class:`StepLimitError` is raised, which the one who set the limit turns into an error or into "unknown":
never into an answer.

The count does not depend on what was asked before: an answer that is remembered (:func:`cached`) costs what it
cost to find.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


class StepLimitError(Exception):
    """The steps that some work may take are spent.

    Attributes:
        steps: how many it might take.
    """

    def __init__(self, steps: int) -> None:
        self.steps = steps
        super().__init__(f"not decided within {steps:,} steps")


@dataclass(slots=True)
class StepCounter:
    """Steps that were counted.

    Attributes:
        allowed: the most there may be; None for any number.
        told: the limit that a message tells: that of the work around, where less than it was left.
        spent: how many there were.
    """

    allowed: int | None
    told: int
    spent: int = 0

    @property
    def left(self) -> int | None:
        """How many steps are left; None for any number."""
        return None if self.allowed is None else max(0, self.allowed - self.spent)

    def within(self, steps: int | None) -> StepCounter:
        """Return a count of its own for a part of the work, which may take so many steps, or all that are left."""
        left = self.left
        if left is None or (steps is not None and steps < left):
            return StepCounter(steps, steps or 0)
        return StepCounter(left, self.told)


_current: ContextVar[StepCounter | None] = ContextVar("_current", default=None)


def spend(steps: int = 1) -> None:
    """Count steps.

    Raises:
        EffortError: there are more than the work may take.
    """
    effort = _current.get()
    if effort is not None:
        effort.spent += steps
        if effort.allowed is not None and effort.spent > effort.allowed:
            raise StepLimitError(effort.told)


@contextmanager
def step_limit(steps: int | None) -> Iterator[StepCounter]:
    """Count the steps of a block, which may take so many; they count for a limit around it, too.

    Args:
        steps: the most steps; None to count only.
    """
    outer = _current.get()
    effort = StepCounter(steps, steps or 0) if outer is None else outer.within(steps)
    token = _current.set(effort)
    try:
        yield effort
    finally:
        _current.reset(token)
        if outer is not None:
            outer.spent += effort.spent


def cached(maxsize: int) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Return a decorator like :func:`functools.lru_cache`; an answer costs the same steps each time.

    Args:
        maxsize: so many answers are remembered.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        @lru_cache(maxsize)
        def costed(*args: _P.args, **kwargs: _P.kwargs) -> tuple[_T, int]:
            outer = _current.get()
            effort = StepCounter(None, 0) if outer is None else outer.within(None)
            token = _current.set(effort)
            try:
                return function(*args, **kwargs), 1 + effort.spent
            except StepLimitError:
                if outer is not None:
                    outer.spent += effort.spent
                raise
            finally:
                _current.reset(token)

        @wraps(function)
        def answer(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            found, cost = costed(*args, **kwargs)  # type: ignore[arg-type]
            spend(cost)
            return found

        return answer

    return decorate
