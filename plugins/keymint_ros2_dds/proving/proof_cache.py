# SPDX-License-Identifier: Apache-2.0
"""Prove permissions documents from their bytes, and cache the claims: an installed document was often just built."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from keymint.api import Claim, ComparisonTask, Proof
from keymint.keymake.kinds import Arguments, Kind, kind_of
from keymint_ros2_dds import decision
from keymint_ros2_dds.decision import shipped_models
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.lowering.lowered_rules import Lowered, lower
from keymint_ros2_dds.proving.claims import prove_document
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance
from keymint_ros2_dds.proving.questions import ProofQuestion

MOST = 10_000
"""Number of documents whose claims are cached."""

_Key = tuple[object, ...]
_proven: dict[_Key, tuple[Claim, ...]] = {}


def prove_content(
    task: ComparisonTask,
    *,
    models: Sequence[str] | None = None,
    lowered: Lowered | None = None,
    governance: EnclaveGovernance | None = None,
) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        task: the document, and what it must permit.
        models: names of the models; None: those that the distribution of the task ships.
        lowered: the rules in terms of DDS, if known.
        governance: the governance of the enclave; None puts everything under access control.

    Raises:
        KeymintError: the document cannot be read, or a rule cannot be mapped.
    """
    names = shipped_models(task.distro) if models is None else tuple(models)
    if governance is not None and governance.transparent(task.domains):
        # A proof without governance holds for one that puts everything under access control.
        claims = prove_content(task, models=models, lowered=lowered)
        if all(claim.proof is Proof.PROVEN for claim in claims):
            return claims
    key = _key(task, kind_of(task.rules.rules), names, b"" if governance is None else governance.key)
    if (known := _proven.get(key)) is not None:
        return known
    document = decision.read(task.document, task.file, task.offset)
    if not document.defects:
        dds_xml.know_valid(task.document, PERMISSIONS)
    question = ProofQuestion(document, task, lower(task.rules, task.distro) if lowered is None else lowered, governance)
    claims = prove_document(question, models=names)
    # Proofs do not depend on the place of the document; counterexamples name it.
    if all(claim.proof is Proof.PROVEN for claim in claims):
        _keep(key, claims)
    return claims


def remember(task: ComparisonTask, rules: tuple[Kind, Arguments], claims: tuple[Claim, ...]) -> None:
    """Remember what is proven about a document, by the models that its distribution ships and without its governance.

    Args:
        task: the document, and what it must permit.
        rules: the kind of its rules, and the names in these.
        claims: what is proven.
    """
    _keep(_key(task, rules, shipped_models(task.distro)), claims)


def know(
    task: ComparisonTask, governance: EnclaveGovernance, models: tuple[str, ...], claims: tuple[Claim, ...]
) -> None:
    """Remember what is proven about a document by some models, together with its governance."""
    key = b"" if governance.transparent(task.domains) else governance.key
    _keep(_key(task, kind_of(task.rules.rules), models, key), claims)


def _keep(key: _Key, claims: tuple[Claim, ...]) -> None:
    if len(_proven) < MOST:
        _proven[key] = claims


def _key(task: ComparisonTask, rules: tuple[Kind, Arguments], models: tuple[str, ...], governance: bytes = b"") -> _Key:
    """Return everything that proven claims depend on."""
    digest = hashlib.sha256(task.document).digest()
    return digest, governance, *rules, task.subject_name, task.rules.subject, task.distro, task.domains, models
