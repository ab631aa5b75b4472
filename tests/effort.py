"""What a call costs, without a clock, since machines are noisy and counting is not; and how much the suite tries."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, TypeVar

_T = TypeVar("_T")

FULL = os.environ.get("KEYMINT_FULL") == "1"
"""Tests try all that they can, and not a sample: ``make test-full``."""


def tries(sample: int, full: int) -> int:
    """Return how many cases a test tries."""
    return full if FULL else sample


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
