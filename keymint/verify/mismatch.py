"""What a comparison finds, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from comarmor.errors import Origin
from keymint.api import PolicyDecision, Tier, Verdict
from keymint.graph import Edge


class MismatchKind(StrEnum):
    """How a transport's label of an edge is wrong; allowing is the positive.

    ``false-positive``: the transport allows what the policy does not. ``false-negative``: the reverse.
    """

    FALSE_POSITIVE = "false-positive"
    FALSE_NEGATIVE = "false-negative"


@dataclass(frozen=True, slots=True)
class ConfusionMatrix:
    """How many edges the policy and a transport label alike and differently; allowing is the positive."""

    true_positive: int = 0
    false_negative: int = 0
    false_positive: int = 0
    true_negative: int = 0

    @property
    def edges(self) -> int:
        """All edges."""
        return self.true_positive + self.true_negative + self.errors

    @property
    def errors(self) -> int:
        """Edges that are labelled differently."""
        return self.false_positive + self.false_negative


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

    error: MismatchKind
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
