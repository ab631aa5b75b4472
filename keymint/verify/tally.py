# SPDX-License-Identifier: Apache-2.0
"""Count the answers of a transport by operation, and its words for denials."""

from __future__ import annotations

from collections import Counter

from keymint.api import Verdict
from keymint.graph import Edge


class Tally:
    """What a transport was asked, and what it answered.

    Attributes:
        asked: number of edges by permission.
        agreed: number of those that it decided as the policy does.
        denied: number of those that it denied.
        texts: number of denials by its words.
    """

    def __init__(self) -> None:
        self.asked: Counter[str] = Counter()
        self.agreed: Counter[str] = Counter()
        self.denied: Counter[str] = Counter()
        self.texts: Counter[str] = Counter()

    def add(self, edge: Edge, verdict: Verdict, *, agreed: bool) -> None:
        """Count a verdict on an edge."""
        self.asked[edge.permission] += 1
        self.agreed[edge.permission] += agreed
        if not verdict.allowed:
            self.denied[edge.permission] += 1
            self.texts[verdict.reason] += 1

    def rows(self) -> list[tuple[str, int, int, int]]:
        """Return each permission with the numbers of edges that were asked, agreed and denied."""
        return [(each, self.asked[each], self.agreed[each], self.denied[each]) for each in sorted(self.asked)]

    def json(self) -> dict[str, object]:
        """Return the members of ``keymint verify --ros --json``."""
        names = ("permission", "asked", "agreed", "denied")
        return {
            "operations": [dict(zip(names, row, strict=True)) for row in self.rows()],
            "denials": [{"text": text, "count": count} for text, count in self.texts.most_common()],
        }
