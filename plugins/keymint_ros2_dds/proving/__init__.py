"""Proofs about permissions documents: over all names, they permit exactly what the policy says.

The document is read again from the signed bytes that are installed, and becomes decision lists, by the standard and by
a model of each vendor; so does the policy. :mod:`keymint.proof` compares them. What it finds is judged once more: on
the policy's side by going through its rules, on the document's side by the decision point.
"""

from __future__ import annotations

from keymint_ros2_dds.proving.claims import ASSUMPTIONS, Held, Question, prove_document
from keymint_ros2_dds.proving.content import prove_content
from keymint_ros2_dds.proving.prove import prove, terms

__all__ = ["ASSUMPTIONS", "Held", "Question", "prove", "prove_content", "prove_document", "terms"]
