# SPDX-License-Identifier: Apache-2.0
"""Prove an installed enclave: read its files again, and verify their signatures."""

from __future__ import annotations

from keymint.api import Claim, ComparisonTask, EnclaveFiles, ProofTask, ValidityTerm
from keymint.errors import Origin, require_none
from keymint.pki import certificates, smime
from keymint.pki.examine import enclave_file
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.decision.semantics import OMG, shipped_models
from keymint_ros2_dds.enclave_layout import CERTIFICATE, GOVERNANCE, PERMISSIONS, PERMISSIONS_ROLE
from keymint_ros2_dds.examine.enclave_rules import differences
from keymint_ros2_dds.proving import grant_periods
from keymint_ros2_dds.proving.claims import prove_content
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance

_Question = tuple[ComparisonTask, EnclaveGovernance, tuple[str, ...]]
"""What the claims about an enclave depend on, once its files are verified: document, governance, and models."""


def prove(task: ProofTask) -> tuple[Claim, ...]:
    """Return the claims about an enclave, by model, action and domains; see :func:`question`."""
    held, governance, models = question(task)
    return prove_content(held, models=models, governance=governance)


def question(task: ProofTask) -> _Question:
    """Verify the files of an enclave, and return what is to be proven.

    Nothing is claimed about an enclave whose trust anchors differ from the workspace's.

    Args:
        task: the enclave, and the policy that it must implement.

    Raises:
        KeymintError: a file of the enclave is missing, cannot be read, or is not issued by the anchors; or a rule of
            the policy cannot be mapped.
    """
    require_none(differences(task.enclave))
    content, place = _signed(task.enclave, PERMISSIONS, unsigned=task.unsigned)
    package, name = task.package, _subject_name(task.enclave)
    held = ComparisonTask(
        content, *place, name, task.rules, package.distro, package.grant.domains, task.states, task.go_on
    )
    signed = _signed(task.enclave, GOVERNANCE, unsigned=task.unsigned)
    models = (OMG.name,) if task.standard_only else shipped_models(task.enclave.anchors.distro or package.distro)
    return held, EnclaveGovernance(*signed, package), models


def terms(enclave: EnclaveFiles) -> tuple[ValidityTerm, ...]:
    """Return the periods of validity of an enclave; see :meth:`keymint.api.Prover.terms`.

    Raises:
        KeymintError: a file is missing, cannot be read, or is not signed by the workspace's authority.
    """
    content, place = _signed(enclave, PERMISSIONS)
    of_grants = grant_periods.of_grants(content, place, _subject_name(enclave), shipped_models(enclave.anchors.distro))
    return (*of_grants, *grant_periods.of_certificates(enclave.files, enclave.folder))


def _signed(enclave: EnclaveFiles, kind: str, *, unsigned: bool = False) -> tuple[bytes, tuple[str, int]]:
    """Return the content of a signed document, its file, and the number of lines before it there."""
    name, plain, folder = f"{kind}.p7s", f"{kind}.xml", enclave.folder
    file, where = enclave_file(enclave.files, folder, name), Origin(f"{folder}/{name}")
    signed = smime.read(file, enclave.anchors.authorities[PERMISSIONS_ROLE].chain, where=where)
    if unsigned or enclave.files.get(plain) == signed.content:
        return signed.content, (f"{folder}/{plain}", 0)
    return signed.content, (where.file, signed.lines_before)


def _subject_name(enclave: EnclaveFiles) -> str:
    file = enclave_file(enclave.files, enclave.folder, CERTIFICATE)
    return subject_names.of_any(certificates.load(file, Origin(f"{enclave.folder}/{CERTIFICATE}")).subject)
