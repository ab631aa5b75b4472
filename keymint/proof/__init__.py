"""Decision lists over patterns, compared over *all* names: equal, or a shortest name on which they differ.

The engine knows nothing of files, robots or transports. A question is exact, lazy and within a budget; what is not
decided within it is :class:`Unknown`, which is never to be taken for equal.
"""

from __future__ import annotations

from keymint.proof.model import (
    EVERY_WORD,
    PRINTABLE,
    Block,
    Budget,
    DecisionList,
    Equal,
    Outcome,
    Universe,
    Unknown,
    Witness,
)
from keymint.proof.plain import permits
from keymint.proof.questions import difference, escapes, implies, intersects, shadowed

__all__ = [
    "EVERY_WORD", "PRINTABLE", "Block", "Budget", "DecisionList", "Equal", "Outcome", "Universe", "Unknown", "Witness",
    "difference", "escapes", "implies", "intersects", "permits", "shadowed",
]  # fmt: skip
