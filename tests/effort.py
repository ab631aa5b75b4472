# SPDX-License-Identifier: Apache-2.0
"""The cost of a call, counted instead of timed since machines are noisy; and how many cases the suite tries."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, TypeVar

_T = TypeVar("_T")

FULL = os.environ.get("KEYMINT_FULL") == "1"
"""Tests try all cases instead of a sample: ``make test-full``."""


def tries(sample: int, full: int) -> int:
    """Return the number of cases that a test tries."""
    return full if FULL else sample


def calls_of(function: Callable[[], _T]) -> tuple[_T, int]:
    """Return the result of a function, and the number of all functions that it called, including those written in C."""
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
