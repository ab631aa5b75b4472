"""Require a proof of every enclave before anything is installed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import LoadedPolicy, Proof
from keymint.changes import Plan
from keymint.commands import proof_diagnostics
from keymint.commands.proof_diagnostics import dated_of, diagnostics_of, effort_of
from keymint.commands.run import Run
from keymint.errors import ExitCode, KeymintError
from keymint.plan.install import HAND_EDITED
from keymint.plan.prove import NO_PROVER, EnclaveProof, prove
from keymint.plan.terms import merged
from keymint.session import Session


def proven(
    run: Run,
    session: Session,
    names: Sequence[str],
    policy: LoadedPolicy,
    plan: Plan,
    *,
    standard_only: bool,
) -> Plan:
    """Prove the enclaves of a plan, and return the plan with the cached proofs.

    Args:
        run: the run.
        session: the workspace as it will be, and its profile.
        names: the packages to install.
        policy: the policy to prove.
        plan: what will be done.
        standard_only: prove by the standard only; vendors may differ.

    Raises:
        KeymintError: a claim about an enclave is refuted or unknown; exit code 3.
    """
    found = prove(
        session, names, policy, effort_of(run), standard_only=standard_only,
        folder=lambda name: session.workspace.build / name,
    )  # fmt: skip
    said = list(dict.fromkeys(diagnostic for enclave in found.enclaves for diagnostic in diagnostics_of(enclave)))
    standard = next(iter(found.assumptions), "")
    of_vendors = {enclave.subject for enclave in found.enclaves if _holds(enclave, standard)}
    refused = [
        replace(each, help=_with_mend(each.help, of_vendors=each.subject in of_vendors))
        for each in said
        if each.code != NO_PROVER
    ]
    if refused:
        edits = _refused_edits(session, plan, {each.subject for each in refused})
        by_edit = {each.subject for each in edits}
        # Other warnings of the plan often name the cause, e.g. a changed policy.
        warned = [each for each in plan.diagnostics if each.code != HAND_EDITED or each.subject not in by_edit]
        unsigned = (proof_diagnostics.unsigned(each, session) for each in refused)
        build = session.workspace.build
        once = proof_diagnostics.alike(unsigned, lambda name: session.workspace.shown(build / name))
        raise KeymintError.of([*warned, *edits, *once], ExitCode.FINDINGS)
    # Validity does not stop an installation: a certificate may become valid tomorrow.
    known = {(each.code, each.subject) for each in plan.diagnostics}
    known |= {(each.code, "") for each in plan.diagnostics}
    dated = [each for each in dated_of(found) if (each.code, _subject_of(each)) not in known]
    warned = [replace(each, severity=Severity.WARNING) for each in (*said, *merged(dated))]
    return replace(plan, state=found.state, diagnostics=(*plan.diagnostics, *warned))


def _subject_of(found: Diagnostic) -> str:
    """Return the subject of a diagnostic; an authority has none."""
    return "" if found.code.startswith("authority-") else found.subject


def _refused_edits(session: Session, plan: Plan, subjects: Collection[str]) -> list[Diagnostic]:
    """Return an error for each manually edited document of subjects whose proof fails."""
    found: dict[Origin, Diagnostic] = {}
    for subject in sorted(subjects):
        name = subject.removeprefix("/")
        package = session.package(name)
        built = [each.where for each in plan.diagnostics if each.code == HAND_EDITED and each.subject == subject]
        discard = {where: f"keymint build -f {name}" for where in built if where}
        if package.permissions.edited:
            discard[package.permissions.origin] = f"keymint create -f {name}"
        for where, command in discard.items():
            message = f"a manual edit changes what {subject} may do"
            help_ = f"change the policy instead; '{command}' discards the edit"
            found[where] = Diagnostic(HAND_EDITED, Severity.ERROR, message, where, help_, subject)
    return list(found.values())


def _holds(enclave: EnclaveProof, standard: str) -> bool:
    """Return whether an enclave is proven by the standard, which a prover names first."""
    own = [claim for claim in enclave.claims if claim.model == standard]
    return bool(own) and all(claim.proof is Proof.PROVEN for claim in own)


def _with_mend(help_: str, *, of_vendors: bool) -> str:
    accept = "accept differences between vendors with --allow-vendor-specific, " if of_vendors else ""
    mend = f"nothing was installed; rebuild it from the policy, {accept}or sign it anyway with --no-prove"
    return f"{help_}; {mend}" if help_ else mend
