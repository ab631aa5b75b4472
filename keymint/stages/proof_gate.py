# SPDX-License-Identifier: Apache-2.0
"""Require a proof of every enclave before anything is installed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial

from comarmor.values import replace
from keymint.api import LoadedPolicy, Proof
from keymint.errors import Diagnostic, ExitCode, KeymintError, Severity
from keymint.names import name_of
from keymint.stages.create import CHANGED
from keymint.stages.documents import HAND_EDITED
from keymint.stages.proof_results import EnclaveProof, ProofEffort, dated_of, diagnostics_of, merged_packages
from keymint.stages.prove import NO_PROVER, STAGE, ProofStage
from keymint.stages.work import Crew, InstallRequest, Work
from keymint.store.changes import Action, Plan
from keymint.workspace.installed_enclaves import INSTALLED
from keymint.workspace.session import Session


def proof_stage(crew: Crew, policy: LoadedPolicy, request: InstallRequest) -> Callable[[Session], ProofStage]:
    """Return what makes the stage that proves documents which are about to be signed.

    Args:
        crew: who plans packages.
        policy: the policy to prove.
        request: what the user asks for.
    """
    effort = ProofEffort(crew.monotonic, standard_only=request.allow_vendor_specific)
    return partial(ProofStage, policy=policy, effort=effort, unsigned=True)


def proven(crew: Crew, work: Work, names: Collection[str], policy: LoadedPolicy, request: InstallRequest) -> Work:
    """Prove the enclaves that some work installs, and return the work with the cached proofs.

    Args:
        crew: who plans packages.
        work: what will be done.
        names: the packages to install, and those about which new shared documents decide.
        policy: the policy to prove.
        request: what the user asks for.

    Raises:
        KeymintError: a claim about an enclave is refuted or unknown; exit code 3.
    """
    session, plan = work.session, work.plan
    kept = work.of(INSTALLED).of_action(Action.KEPT, Action.REMOVED)
    stage = proof_stage(crew, policy, request)(session)
    results = stage.results(crew.planned(stage, [name for name in sorted(names) if name not in kept]))
    diagnostics = diagnostics_of(results, strict=request.strict)
    of_vendors = {enclave.subject for enclave in results.enclaves if _holds(enclave, results.standards)}
    changed = any(each.code == CHANGED for each in plan.diagnostics)
    refused: list[Diagnostic] = []
    for each in diagnostics:
        by_vendors_only = each.subject in of_vendors
        if each.code != NO_PROVER and not (by_vendors_only and _goes_on(session, each.subject)):
            accept = "accept differences between vendors with --allow-vendor-specific, " if by_vendors_only else ""
            remedy = f"nothing was installed; rebuild it from the policy, {accept}or sign it anyway with --no-prove"
            if changed:
                remedy = (
                    "nothing was installed; the policy changed: run 'keymint create --all' and 'keymint build' first"
                )
            refused.append(replace(each, help=f"{each.help}; {remedy}" if each.help else remedy))

    def shown(name: str) -> str:
        return session.workspace.shown(session.workspace.build / name)

    if refused:
        edits = _refused_edits(session, plan, refused)
        by_edit = {each.where for each in edits}
        causes = {each.subject for each in edits}
        refused = [each for each in refused if each.subject not in causes and "" not in causes]
        # Other warnings of the plan often name the cause, e.g. a changed policy.
        warnings = [each for each in plan.diagnostics if each.code != HAND_EDITED or each.where not in by_edit]
        raise KeymintError.of([*warnings, *edits, *merged_packages(refused, shown)], ExitCode.FINDINGS)
    # Validity does not stop an installation: a certificate may become valid tomorrow.
    known = {each.code for each in plan.diagnostics}  # what the dates of the sources say already
    validity = [each for each in dated_of(results) if each.code not in known]
    warnings = [replace(each, severity=Severity.WARNING) for each in (*diagnostics, *merged_packages(validity, shown))]
    return work.recording(results.state).noting(*warnings, part=STAGE)


def _refused_edits(session: Session, plan: Plan, refused: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Return an error for each manually edited document of subjects whose proof fails, with the first refuted claim."""
    claims = {each.subject: each.message for each in reversed(refused)} | {"": refused[0].message}
    claims = {subject: message.removeprefix(f"{subject}: ") for subject, message in claims.items()}
    subjects = {each.subject for each in refused}
    edited = [(each.where, each.subject) for each in plan.diagnostics if each.code == HAND_EDITED and each.where]
    # A document that all subjects share has no subject.
    found = [(where, "", "keymint build -f") for where, subject in edited if not subject]
    for subject in sorted(filter(None, subjects)):
        name = name_of(subject)
        found += [(where, subject, f"keymint build -f {name}") for where, edited_for in edited if edited_for == subject]
        grant = session.package(name).grant
        if grant.edited:
            found.append((grant.origin, subject, f"keymint create -f {name}"))
    edits = {
        where: Diagnostic.error(
            HAND_EDITED,
            f"a manual edit changes what {subject or 'the subjects'} may do: {claims[subject]}",
            where,
            f"nothing was installed; change the policy instead: '{command}' discards the edit; --no-prove signs it",
            subject,
        )
        for where, subject, command in found
    }
    return list(edits.values())


def _goes_on(session: Session, subject: str) -> bool:
    """Tell whether a subject goes on with all documents that another tool signed: nothing new is signed for it."""
    name = name_of(subject)
    kept = session.package(name).kept
    return bool(kept) and all(
        session.tree.read(session.workspace.build / name / document) == content for document, content in kept.items()
    )


def _holds(enclave: EnclaveProof, standards: Collection[str]) -> bool:
    """Return whether an enclave is proven by the standards, so that only vendors differ."""
    own = [claim for claim in enclave.claims if claim.model in standards]
    return bool(own) and all(claim.proof is Proof.PROVEN for claim in own)
