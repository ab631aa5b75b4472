"""The policy decision point: what a permissions document says, by the standard and by each vendor."""

from __future__ import annotations

from keymint_ros2_dds.decision.explain import explain
from keymint_ros2_dds.decision.judge import Decision, Judge, Outcome, decide
from keymint_ros2_dds.decision.semantics import (
    CYCLONEDDS_0_10,
    FASTDDS_2_9,
    OMG,
    VARIATIONS,
    Deviation,
    Semantics,
    Variation,
)
from keymint_ros2_dds.reading.permissions_document import PermissionsDocument, read

__all__ = [
    "CYCLONEDDS_0_10", "FASTDDS_2_9", "OMG", "VARIATIONS", "Decision", "Deviation", "Judge", "Outcome",
    "PermissionsDocument", "Semantics", "Variation", "decide", "explain", "read",
]  # fmt: skip
