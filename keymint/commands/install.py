# SPDX-License-Identifier: Apache-2.0
"""``keymint install``: sign built documents and stage enclaves."""

from __future__ import annotations

from functools import partial

import click

from keymint.changes import Plan
from keymint.commands.build import no_packages
from keymint.commands.options import (
    new_authority_option,
    packages_argument,
    prove_option,
    prune_option,
    revoke_superseded_option,
    standard_only_option,
    strict_option,
)
from keymint.commands.proof_gate import proof_stage, proven
from keymint.commands.reissue import reissued, superseded
from keymint.commands.run import Run, exit_code_of
from keymint.commands.verb import verb
from keymint.errors import ExitCode
from keymint.output.report import Report, findings_exit
from keymint.plan.authorities import plan_authorities
from keymint.plan.install import InstallStage
from keymint.plan.policy import lazy_policy
from keymint.plan.policy_drift import UNCREATED, policy_changed, uncreated
from keymint.plan.revocation import plan_lists
from keymint.plan.revoking import plan_revocation
from keymint.register.register import SUPERSEDED
from keymint.session import Session


@verb(jobs=True, dry_run=True)
@packages_argument
@prune_option
@new_authority_option
@prove_option
@standard_only_option
@strict_option
@revoke_superseded_option
def install(
    run: Run,
    names: tuple[str, ...],
    prune: bool,
    new_authority: tuple[str, ...],
    prove: bool,
    allow_vendor_specific: bool,
    strict: bool,
    revoke_superseded: bool,
) -> Report:
    """Sign the documents in build/ and stage them in install/, one complete enclave per subject.

    Nothing is installed unless each document is proven to permit exactly what the policy allows, for all names; see
    'keymint prove --help'. Unchanged certificates and signed documents are kept. Each enclave can be copied to a robot
    by itself; private keys of authorities are never staged. NAME is a package [all].
    """
    if names and new_authority:
        raise click.UsageError("--new-authority applies to all enclaves; do not name packages.")

    def make_plan(session: Session) -> Plan:
        new = () if run.resumes else new_authority
        plan, authorities = plan_authorities(session, new)
        plan = plan.then(plan_lists(session.after(plan), authorities))
        after = session.after(plan)
        chosen = run.names(session, names)
        install = partial(InstallStage, authorities=authorities, prune=prune)
        proof = proof_stage(run, lazy_policy(session), standard_only=allow_vendor_specific) if prove else None
        run.workers.start(after, chosen, (install, *((proof,) if proof else ())))
        installed = run.planned(install(after), chosen)
        if narrower := superseded(session, installed, asked=revoke_superseded):
            run.workers.close()
            first = plan_revocation(session, narrower, SUPERSEDED).plan
            return reissued(run, session, first, chosen, prove=prove, new_authority=new)
        warnings = policy_changed(session) if chosen else (no_packages(session),)
        missing = () if names or (chosen and not prove) else uncreated(session, lazy_policy(session), chosen)
        done = plan.then(installed).noting(*warnings, *missing)
        return proven(run, after, installed, chosen, proof, done, strict=strict) if proof else done

    def exit_code(plan: Plan) -> ExitCode:
        nothing = findings_exit([finding for finding in plan.diagnostics if finding.code == UNCREATED])
        return exit_code_of(plan) or nothing

    return run.change(make_plan, exit_code)
