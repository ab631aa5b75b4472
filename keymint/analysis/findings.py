# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the analysis."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.errors import Diagnostic, Origin
from comarmor.text import first_few


def undecided_note(message: str, where: Origin | None, help_: str) -> Diagnostic:
    """Return a note that a check ended at its limit of steps."""
    return Diagnostic.note("lint-unknown", message, where, help_)


def quoted_list(expressions: Sequence[str]) -> str:
    """Return the first expressions for a message."""
    return first_few([repr(each) for each in expressions], 3)
