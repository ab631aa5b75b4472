# SPDX-License-Identifier: Apache-2.0
"""Mismatches between policy and transports, and their counts."""

from __future__ import annotations

from collections.abc import Mapping

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import PolicyDecision, Tier, Verdict
from keymint.api.graph import ConfusionMatrix, Edge, EdgeOutcome


@dataclass(frozen=True, slots=True)
class Mismatch:
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


@dataclass(frozen=True, slots=True)
class Comparison:
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
