"""What a comparison finds, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from comarmor.errors import Origin
from keymint.api import PolicyDecision, Tier, Verdict
from keymint.graph import ConfusionMatrix, Edge, EdgeOutcome


@dataclass(frozen=True, slots=True)
class Mismatch:
    """An edge that a transport labels differently from the policy, and why.

    Attributes:
        error: false positive or false negative.
        edge: the edge.
        policy: what the policy says; its ``where`` is the rule that decides, or none.
        verdict: what the transport decides, and says itself.
        reason: one line: why it does, in the words of the model of it where there is one.
        document: the rule in the enclave's document that decides; without a line where no rule does.
        model: the simulated transport that explains the verdict of a real one, or empty.
    """

    error: EdgeOutcome
    edge: Edge
    policy: PolicyDecision
    verdict: Verdict
    reason: str
    document: Origin
    model: str = ""


@dataclass(frozen=True, slots=True)
class Comparison:
    """What came of holding one transport against the policy.

    Attributes:
        transport: its name.
        version: its version, as it says itself.
        tier: how deep it was asked.
        confusion: counts of all edges.
        findings: the first of the edges that are labelled differently, in the order of the edges.
        wrong: subjects with such edges, and how many.
    """

    transport: str
    version: str
    tier: Tier
    confusion: ConfusionMatrix
    findings: tuple[Mismatch, ...]
    wrong: Mapping[str, int]

    @property
    def omitted(self) -> int:
        """How many findings are counted but not kept."""
        return self.confusion.errors - len(self.findings)
