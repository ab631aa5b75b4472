"""Proofs about permissions documents: over all names, they permit exactly what the policy says.

The signed document is read again as installed, and turned into decision lists: by the standard, and by a model of each
vendor. So is the policy, and :mod:`comarmor.patterns.proofs` compares them. Each counterexample
is checked once more: on the policy's side by evaluating its rules, on the document's side by the decision point.
"""

from __future__ import annotations

from keymint_ros2_dds.proving.claims import ASSUMPTIONS, ProofQuestion, ProofSpec, prove_document
from keymint_ros2_dds.proving.enclave_proof import prove, terms
from keymint_ros2_dds.proving.proof_cache import prove_content

__all__ = ["ASSUMPTIONS", "ProofQuestion", "ProofSpec", "prove", "prove_content", "prove_document", "terms"]
