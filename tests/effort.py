"""What a call costs, without a clock: machines are noisy, and counting is not."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

_T = TypeVar("_T")


def calls_of(function: Callable[[], _T]) -> tuple[_T, int]:
    """Return what a function returns, and how many functions it called in all, those written in C included."""
    count = 0

    def on_event(_frame: Any, event: str, _argument: Any) -> None:
        nonlocal count
        count += event in {"call", "c_call"}

    before = sys.getprofile()
    sys.setprofile(on_event)
    try:
        return function(), count
    finally:
        sys.setprofile(before)
