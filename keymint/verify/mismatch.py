# SPDX-License-Identifier: Apache-2.0
"""Mismatches between policy and transports, and counts of them and of all answers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from comarmor.values import Data
from keymint.api import PolicyDecision, Tier, Verdict
from keymint.api.graph import ConfusionMatrix, Edge, EdgeOutcome
from keymint.errors import Origin


class Mismatch(Data):
    """An edge that a transport labels differently from the policy, with the reason.

    Attributes:
        edge: the edge.
        policy: the policy's decision.
        verdict: the transport's decision, in its own words.
        reason: one line, from the simulation of the transport if there is one.
        document: the rule in a document that decided; without a line if no rule did.
        model: the simulated transport that explains the verdict of a real one, or empty.
    """

    edge: Edge
    policy: PolicyDecision
    verdict: Verdict
    reason: str
    document: Origin
    model: str = ""

    @property
    def error(self) -> EdgeOutcome:
        """How the edge is labelled wrongly: false positive or false negative."""
        return EdgeOutcome.FALSE_POSITIVE if self.verdict.allowed else EdgeOutcome.FALSE_NEGATIVE


class EdgeComparison(Data):
    """The comparison of one transport with the policy.

    Attributes:
        transport: its name.
        version: its version.
        tier: the tier of the test.
        confusion: counts of all edges.
        findings: the first mismatches, in the order of the edges.
        wrong: number of mismatches by subject.
        endpoints: number of findings, at the end, that are single endpoints of an edge.
    """

    transport: str
    version: str
    tier: Tier
    confusion: ConfusionMatrix
    findings: tuple[Mismatch, ...]
    wrong: Mapping[str, int]
    endpoints: int = 0

    @property
    def omitted(self) -> int:
        """Number of mismatches that are counted but not kept."""
        return self.confusion.errors - len(self.findings)


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
