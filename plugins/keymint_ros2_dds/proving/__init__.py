# SPDX-License-Identifier: Apache-2.0
"""Prove that permissions documents permit exactly what the policy allows, over all names.

The installed, signed document is read again and translated into decision lists: as the standard reads it, and as the
model of each vendor does. :mod:`comarmor.patterns.proofs` compares them with the decision lists of the policy. Each
counterexample is checked again by evaluating the policy's rules, and by the decision point.
"""

from __future__ import annotations

from keymint_ros2_dds.proving.claims import ASSUMPTIONS, prove_document
from keymint_ros2_dds.proving.proof_cache import prove_content
from keymint_ros2_dds.proving.questions import ProofQuestion

__all__ = ["ASSUMPTIONS", "ProofQuestion", "prove_content", "prove_document"]
