# SPDX-License-Identifier: Apache-2.0
"""Prove permissions documents from their bytes, and cache the claims: an installed document was often just built."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from keymint.api import Claim, Proof
from keymint_ros2_dds import decision
from keymint_ros2_dds.lowering.lower import Lowered, lower
from keymint_ros2_dds.proving.claims import ASSUMPTIONS, ProofQuestion, ProofSpec, prove_document
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance

MOST = 10_000
"""Number of documents whose claims are cached."""

_proven: dict[bytes, tuple[Claim, ...]] = {}


def prove_content(
    content: bytes,
    place: tuple[str, int],
    spec: ProofSpec,
    *,
    models: Sequence[str] | None = None,
    lowered: Lowered | None = None,
    governance: EnclaveGovernance | None = None,
) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        content: the document, unsigned.
        place: its file as the user would type it, and the number of lines before it there.
        spec: what it must permit.
        models: names of the models, of :data:`ASSUMPTIONS`; None: all.
        lowered: the rules in terms of DDS, if known.
        governance: the governance of the enclave; None puts everything under access control.

    Raises:
        KeymintError: the document cannot be read, or a rule cannot be mapped.
    """
    names = tuple(ASSUMPTIONS if models is None else models)
    if governance is not None and governance.transparent(spec.domains):
        # A proof without governance holds for one that puts everything under access control.
        claims = prove_content(content, place, spec, models=models, lowered=lowered)
        if all(claim.proof is Proof.PROVEN for claim in claims):
            return claims
    key = _key(content, spec, names, governance)
    known = _proven.get(key)
    if known is not None:
        return known
    document = decision.read(content, *place)
    question = ProofQuestion(document, spec, lower(spec.rules, spec.distro) if lowered is None else lowered, governance)
    claims = prove_document(question, models=names)
    # Proofs do not depend on the place of the document; counterexamples name it.
    if len(_proven) < MOST and all(claim.proof is Proof.PROVEN for claim in claims):
        _proven[key] = claims
    return claims


def _key(content: bytes, spec: ProofSpec, models: tuple[str, ...], governance: EnclaveGovernance | None) -> bytes:
    """Return a digest of everything that proven claims depend on."""
    rules = tuple((r.effect, r.kind, r.permissions, r.expressions, r.partitions) for r in spec.rules.rules)
    text = repr((spec.subject_name, spec.rules.subject, rules, spec.distro, spec.domains, models))
    text += "" if governance is None else governance.key.hex()
    return hashlib.sha256(hashlib.sha256(content).digest() + text.encode()).digest()
