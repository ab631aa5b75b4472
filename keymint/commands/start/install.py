# SPDX-License-Identifier: Apache-2.0
"""``keymint install``: sign built documents and stage enclaves."""

from __future__ import annotations

from functools import partial

import click

from keymint.authority.authorities import plan_authorities
from keymint.command_line.options import install_request, packages_argument, standard_only_option
from keymint.command_line.verb import verb
from keymint.commands.start.build import no_packages
from keymint.errors import ExitCode
from keymint.life.revocation_lists_in_force import plan_lists
from keymint.output.report import Report, findings_exit
from keymint.run.run import Run, exit_code_of
from keymint.stages.distribution import plan_distribution
from keymint.stages.install import InstallStage
from keymint.stages.install_request import InstallRequest
from keymint.stages.policy_drift import UNCREATED, policy_changed, uncreated
from keymint.stages.proof.proof_gate import proof_stage, proven
from keymint.stages.reissue import following, rebuilt, superseding
from keymint.store.changes import Plan
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session


@verb(jobs=True, dry_run=True)
@packages_argument
@standard_only_option
@install_request
def install(run: Run, names: tuple[str, ...], request: InstallRequest) -> Report:
    """Sign the documents in build/ and stage them in install/, one complete enclave per subject.

    Nothing is installed unless each document is proven to permit exactly what the policy allows, for all names; see
    'keymint prove --help'. Unchanged certificates and signed documents are kept. Each enclave can be copied to a robot
    by itself; private keys of authorities are never staged. NAME is a package [all].
    """
    if names and request.new_authority:
        raise click.UsageError("--new-authority applies to all enclaves; do not name packages.")

    def exit_code(plan: Plan) -> ExitCode:
        nothing = findings_exit([finding for finding in plan.diagnostics if finding.code == UNCREATED])
        return exit_code_of(plan) or nothing

    def make_plan(session: Session) -> Plan:
        left = request.resumed(resumes=run.resumes)
        return _installed(run, session, Plan((), session.state), names, left)

    return run.change(make_plan, exit_code)


def _installed(run: Run, before: Session, first: Plan, names: tuple[str, ...], request: InstallRequest) -> Plan:
    """Return a plan followed by the installation of some packages.

    Args:
        run: the run.
        before: the workspace before the plan, and its profile.
        first: the revocation of certificates that the installation would supersede; it does nothing in the first pass.
        names: the packages that the user named.
        request: what the user asks for.

    Raises:
        KeymintError: a package cannot be signed or proven, or an authority cannot sign; with all defects.
    """
    start = before.after(first)
    plan, authorities = plan_authorities(start, request.new_authority)
    listed = plan_lists(start.after(plan), authorities)
    plan = first.then(plan).then(listed)
    session, chosen = before.after(plan), run.names(before, names)
    if first.writes():
        built_again = following(before, session, [step.package for step in first.steps], listed)
        built, _ = rebuilt(session, built_again, request)
        plan, session = plan.then(built), session.after(built)
        chosen = tuple(dict.fromkeys((*chosen, *built_again)))
    install = partial(InstallStage, authorities=authorities, prune=request.prune)
    proof = proof_stage(run.crew, lazy_policy(session), request) if request.prove else None
    run.workers.start(session, chosen, (install, *((proof,) if proof else ())))
    installed = run.planned(install(session), chosen)
    if narrower := superseding(start, installed, request):
        run.workers.close()
        return _installed(run, before, first.then(narrower), names, request)
    if first.writes():
        installed = installed.then(plan_distribution(before, session.after(installed), chosen))
    warnings = policy_changed(before) if chosen else (no_packages(before),)
    missing = () if names or (chosen and not request.prove) else uncreated(before, lazy_policy(before), chosen)
    plan = plan.then(installed).noting(*warnings, *missing)
    return proven(run.crew, session, installed, chosen, proof, plan, request) if proof else plan
