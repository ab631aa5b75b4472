"""The policy decision point: decide by a permissions document, as the standard and each vendor do."""

from __future__ import annotations

from keymint_ros2_dds.decision.evaluator import DecisionOutcome, DocumentEvaluator, EndpointDecision, decide
from keymint_ros2_dds.decision.semantics import (
    CYCLONEDDS_0_10,
    FASTDDS_2_9,
    OMG,
    VARIATIONS,
    Deviation,
    Semantics,
    Variation,
    explain,
)
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument, read

__all__ = [
    "CYCLONEDDS_0_10",
    "FASTDDS_2_9",
    "OMG",
    "VARIATIONS",
    "DecisionOutcome",
    "Deviation",
    "DocumentEvaluator",
    "EndpointDecision",
    "PermissionsDocument",
    "Semantics",
    "Variation",
    "decide",
    "explain",
    "read",
]  # fmt: skip
