# SPDX-License-Identifier: Apache-2.0
"""Count the steps of a search, so that every search ends, after the same work on every machine.

A step is one pair of patterns compared, or one state visited. The caller sets the limit (:func:`step_limit`), the
algorithms count (:func:`spend`). When the limit is reached, :class:`StepLimitError` is raised. Whoever set the limit
turns it into an error or into "unknown", never into an answer.

An answer from a cache of this package (:func:`step_counting_cache`) costs the steps that computing it cost, so that the
count of a search does not depend on earlier ones. Caches above it, as that of compiled kinds of subjects, save steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache, wraps
from math import inf
from typing import ParamSpec, TypeVar

from comarmor.values import Data

_P = ParamSpec("_P")
_T = TypeVar("_T")


class StepLimitError(Exception):
    """A search reached its step limit.

    Attributes:
        steps: the limit.
    """

    def __init__(self, steps: int) -> None:
        self.steps = steps
        super().__init__(f"not decided within {steps:,} steps")


class StepCounter(Data, frozen=False):
    """The steps taken so far, and their limit.

    Attributes:
        allowed: the limit; infinite for no limit.
        reported: the limit to report; it is an outer one's if that leaves fewer steps.
        spent: steps taken.
    """

    allowed: float = inf
    reported: int = 0
    spent: int = 0


_current: ContextVar[StepCounter] = ContextVar("_current", default=StepCounter())  # noqa: B039 - only counts


def spend(steps: int = 1) -> None:
    """Count steps.

    Raises:
        StepLimitError: the limit is exceeded.
    """
    counter = _current.get()
    counter.spent += steps
    if counter.spent > counter.allowed:
        raise StepLimitError(counter.reported)


@contextmanager
def step_limit(steps: int | None) -> Iterator[StepCounter]:
    """Limit the steps of a block; they count towards an outer limit as well.

    Args:
        steps: the limit, if fewer than these do not remain of an outer one; None only counts.
    """
    outer = _current.get()
    remaining = max(0, outer.allowed - outer.spent)
    if steps is None or steps >= remaining:
        counter = StepCounter(remaining, outer.reported)
    else:
        counter = StepCounter(steps, steps)
    token = _current.set(counter)
    try:
        yield counter
    finally:
        _current.reset(token)
        outer.spent += counter.spent


def step_counting_cache(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Return a function with a :func:`functools.lru_cache` whose hits cost as many steps as the first call."""

    @lru_cache(1 << 14)
    def compute(*args: _P.args, **kwargs: _P.kwargs) -> tuple[_T, int]:
        with step_limit(None) as counter:
            result = function(*args, **kwargs)
        spend(-counter.spent)  # those of a result are counted below, at every call; those of an error were now
        return result, 1 + counter.spent

    @wraps(function)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        result, cost = compute(*args, **kwargs)  # type: ignore[arg-type]
        spend(cost)
        return result

    return wrapper
