# SPDX-License-Identifier: Apache-2.0
"""Count the answers of a transport by operation, and its words for denials."""

from __future__ import annotations

from collections import Counter

from keymint.api import Verdict
from keymint.api.graph import Edge


class Tally:
    """What a transport was asked, and what it answered.

    Attributes:
        rows: by permission, the numbers of edges that were asked, decided as the policy does, and denied.
        texts: number of denials by the transport's words.
    """

    def __init__(self) -> None:
        self.rows: dict[str, list[int]] = {}
        self.texts: Counter[str] = Counter()

    def add(self, edge: Edge, verdict: Verdict, *, agreed: bool) -> None:
        """Count a verdict on an edge."""
        row = self.rows.setdefault(edge.permission, [0, 0, 0])
        for at, counts in enumerate((True, agreed, not verdict.allowed)):
            row[at] += counts
        if not verdict.allowed:
            self.texts[verdict.reason] += 1

    def json(self) -> dict[str, object]:
        """Return the members of ``keymint verify --ros --json``."""
        names = ("permission", "asked", "agreed", "denied")
        return {
            "operations": [dict(zip(names, (each, *row), strict=True)) for each, row in sorted(self.rows.items())],
            "denials": [{"text": text, "count": count} for text, count in self.texts.most_common()],
        }
