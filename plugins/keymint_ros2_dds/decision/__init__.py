# SPDX-License-Identifier: Apache-2.0
"""The policy decision point: decide by a permissions document, as the standard and each vendor do."""

from __future__ import annotations

from keymint_ros2_dds.decision.evaluator import DecisionOutcome as DecisionOutcome
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator as DocumentEvaluator
from keymint_ros2_dds.decision.evaluator import EndpointDecision as EndpointDecision
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10 as CYCLONEDDS_0_10
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_11 as CYCLONEDDS_11
from keymint_ros2_dds.decision.semantics import FASTDDS_2_9 as FASTDDS_2_9
from keymint_ros2_dds.decision.semantics import FASTDDS_2_11 as FASTDDS_2_11
from keymint_ros2_dds.decision.semantics import FASTDDS_3_3 as FASTDDS_3_3
from keymint_ros2_dds.decision.semantics import OMG as OMG
from keymint_ros2_dds.decision.semantics import VARIATIONS as VARIATIONS
from keymint_ros2_dds.decision.semantics import Variation as Variation
from keymint_ros2_dds.decision.semantics import explain as explain
from keymint_ros2_dds.decision.semantics import of_version as of_version
from keymint_ros2_dds.decision.semantics import shipped_models as shipped_models
from keymint_ros2_dds.reading.signed_permissions import read as read
