# SPDX-License-Identifier: Apache-2.0
"""Proofs about enclaves on other machines: they get documents and rules; signatures and keys are verified here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from keymint.api import Claim, Proof, ProofTask
from keymint.errors import KeymintError
from keymint_ros2_dds.proving.enclave_proof import EnclaveQuestion
from keymint_ros2_dds.proving.enclave_proof import question as local_question
from keymint_ros2_dds.proving.proof_cache import know, prove_content


def question(task: ProofTask) -> EnclaveQuestion:
    """See :meth:`keymint.api.RemoteProver.question`."""
    asked = local_question(task)
    return replace(asked, task=replace(asked.task, go_on=_always))


def _always() -> bool:
    return True


def proving() -> Callable[..., Sequence[Sequence[Claim]]]:
    """See :meth:`keymint.api.RemoteProver.proving`."""
    return prove_part


def prove_part(_plugins: object, asked: Sequence[EnclaveQuestion]) -> tuple[tuple[Claim, ...], ...]:
    """Prove claims on a worker; none about a document that cannot be read, which is found again where the user is."""
    return tuple(map(_claims, asked))


def _claims(asked: EnclaveQuestion) -> tuple[Claim, ...]:
    try:
        return prove_content(asked.task, models=asked.models, governance=asked.governance)
    except KeymintError:
        return ()


def receive(asked: EnclaveQuestion, claims: tuple[Claim, ...]) -> None:
    """Keep claims that are all proven; others are decided again here, with their places."""
    if claims and all(claim.proof is Proof.PROVEN for claim in claims):
        know(asked.task, asked.governance, asked.models, claims)
