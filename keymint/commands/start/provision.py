# SPDX-License-Identifier: Apache-2.0
"""``keymint provision``: all stages in one step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import click

from comarmor.errors import Origin
from keymint.api import BuildOptions, LoadedPolicy
from keymint.authority.authorities import plan_authorities
from keymint.command_line.accepted_packages import AcceptanceOptions, accept, acceptance_options, release
from keymint.command_line.options import (
    DEFAULT_PROFILE_TYPE,
    PATH,
    DocumentOptions,
    document_options,
    install_request,
    renew_option,
)
from keymint.command_line.verb import verb
from keymint.commands.start.build import build_options, policy_slips, unknown_hints
from keymint.commands.start.init import ProfileOptions, bootstrap_request, profile_options, refuse_contradiction
from keymint.life.revocation_lists_in_force import plan_lists
from keymint.names import no_subject
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.stages.build import BuildStage
from keymint.stages.create import CreateStage, packages_to_create
from keymint.stages.distribution import plan_distribution
from keymint.stages.install import InstallStage
from keymint.stages.install_request import InstallRequest
from keymint.stages.proof.proof_gate import proof_stage, proven
from keymint.stages.reissue import superseding
from keymint.stages.workspace_start import plan_init, plan_policy, policy_path, refuse_unsupported
from keymint.store.changes import Plan
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Inputs, Session


@verb(jobs=True, dry_run=True, executor=True)
@click.argument("policy", type=PATH)
@profile_options
@click.option("-f", "--force", is_flag=True, help="Discard manual edits of packages' rules and of built documents.")
@renew_option
@document_options
@install_request
@acceptance_options
def provision(
    run: Run,
    policy: Path,
    profile: ProfileOptions,
    document_options: DocumentOptions,
    request: InstallRequest,
    acceptance: AcceptanceOptions,
) -> Report:
    """Turn a ComArmor POLICY into a keystore in one step: init, create --all, build and install.

    Everything is planned and validated before anything is written. Run it again after each change of the policy: only
    affected packages are rebuilt and signed, and keys are kept. Nothing is installed unless each document is proven to
    permit exactly what the policy allows, for all names.
    """
    workspace = run.workspace_at(None)
    options = build_options(run, document_options)
    request = replace(request, build=options, allow_vendor_specific=options.allow_vendor_specific)
    bootstrap = bootstrap_request(run, workspace, policy, profile)
    if workspace.exists():
        refuse_contradiction(run, workspace, profile)

    def make_plan(inputs: Inputs) -> Plan:
        plan = _profile_plan(inputs)
        plan = plan.then(accept(inputs.after(plan).session(), acceptance))
        session = inputs.after(plan).session()
        acquired = lazy_policy(session)
        plan, session = release(inputs, plan, session, acquired)
        names = packages_to_create(session, acquired)
        if not names:
            raise no_subject(
                "attach a profile to a name without wildcards, or use 'keymint create NAME'", Origin(str(policy))
            )
        unknown = unknown_hints(options, document_options.hints, (*names, *session.needed_infrastructure()))
        left = request.resumed(resumes=run.resumes)
        return plan.then(_provisioned(run, session, Plan((), session.state, unknown), acquired, names, left))

    def _profile_plan(inputs: Inputs) -> Plan:
        if not inputs.workspace.exists():
            plan = plan_init(inputs, profile.profile_type or DEFAULT_PROFILE_TYPE, bootstrap)
            refuse_unsupported(inputs.after(plan).session())
            return plan
        return plan_policy(inputs.session(), policy_path(run.setting.cwd / policy, inputs.workspace.profile))

    return run.carry_out(workspace, make_plan)


def _provisioned(
    run: Run, before: Session, first: Plan, policy: LoadedPolicy, names: Sequence[str], request: InstallRequest
) -> Plan:
    """Return a plan followed by all stages for some packages.

    Args:
        run: the run.
        before: the workspace before the plan, and its profile.
        first: the revocation of certificates that the run would supersede; it does nothing in the first pass.
        policy: the policy.
        names: the packages of subjects.
        request: what the user asks for.

    Raises:
        KeymintError: a package cannot be created, built, signed or proven, or an authority cannot sign; with all
            defects.
    """
    start = before.after(first)
    # Processes begin with the authorities, which then sign the last.
    minted, authorities = plan_authorities(start, request.new_authority)
    minted = minted.then(plan_lists(start.after(minted), authorities))
    session = start.after(minted)
    options = request.build or BuildOptions()
    create = partial(CreateStage, policy=policy, force=request.force)
    build = partial(BuildStage, options=options, force=request.force, renew=request.renew, policy=policy)
    install = partial(InstallStage, authorities=authorities, prune=request.prune)
    proof = proof_stage(run.crew, policy, request)
    subjects = create(session).subjects(names)
    if run.has_cluster:
        ahead = create(session)
        created = ahead.plan([ahead.package(name) for name in subjects])
        # Processes begin with what the cluster compiled.
        run.compile_elsewhere(session.after(created), subjects, options, prove=request.prove)
    run.workers.start(session, subjects, (create, build, install, *((proof,) if request.prove else ())))
    created = run.planned(create(session), subjects)
    session = session.after(created)
    every = (*names, *session.infrastructure())
    built = run.planned(build(session), every)
    session = session.after(built)
    installed = run.planned(install(session), every)
    if narrower := superseding(start, installed, request):
        run.workers.close()
        return _provisioned(run, before, first.then(narrower), policy, names, request)
    if first.writes():
        installed = installed.then(plan_distribution(before, session.after(installed), every))
    plan = first.then(created).then(built).then(minted).then(installed)
    plan = plan.noting(*policy_slips(session, (*created.steps, *built.steps), policy))
    return proven(run.crew, session, installed, every, proof, plan, request) if request.prove else plan
