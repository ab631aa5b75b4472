# SPDX-License-Identifier: Apache-2.0
"""``keymint provision``: all stages in one step."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from comarmor.errors import Origin
from keymint.changes import Plan
from keymint.commands.accepted_packages import AcceptanceOptions, accept, acceptance_options, release
from keymint.commands.build import build_options, policy_slips, unknown_hints
from keymint.commands.init import bootstrap_request, refuse_contradiction
from keymint.commands.options import (
    DEFAULT_PROFILE_TYPE,
    PATH,
    DocumentOptions,
    ProfileOptions,
    document_options,
    new_authority_option,
    profile_options,
    prove_option,
    prune_option,
    renew_option,
    revoke_superseded_option,
    strict_option,
)
from keymint.commands.proof_gate import proof_stage, proven
from keymint.commands.reissue import reissued, superseded
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.errors import KeymintError
from keymint.output.report import Report
from keymint.plan.authorities import plan_authorities
from keymint.plan.bootstrap import plan_init, plan_policy, policy_path, refuse_unsupported
from keymint.plan.build import BuildStage
from keymint.plan.create import CreateStage, packages_to_create
from keymint.plan.install import InstallStage
from keymint.plan.policy import lazy_policy
from keymint.plan.revocation import plan_lists
from keymint.plan.revoking import plan_revocation
from keymint.register.register import SUPERSEDED
from keymint.session import Inputs


@verb(jobs=True, dry_run=True, executor=True)
@click.argument("policy", type=PATH)
@profile_options
@click.option("-f", "--force", is_flag=True, help="Discard manual edits of packages' rules and of built documents.")
@prune_option
@renew_option
@document_options
@new_authority_option
@prove_option
@strict_option
@revoke_superseded_option
@acceptance_options
def provision(
    run: Run,
    policy: Path,
    profile: ProfileOptions,
    force: bool,
    prune: bool,
    renew: bool,
    document_options: DocumentOptions,
    new_authority: tuple[str, ...],
    prove: bool,
    strict: bool,
    revoke_superseded: bool,
    acceptance: AcceptanceOptions,
) -> Report:
    """Turn a ComArmor POLICY into a keystore in one step: init, create --all, build and install.

    Everything is planned and validated before anything is written. Run it again after each change of the policy: only
    affected packages are rebuilt and signed, and keys are kept. Nothing is installed unless each document is proven to
    permit exactly what the policy allows, for all names.
    """
    workspace = run.workspace_at(None)
    options = build_options(run, document_options)
    request = bootstrap_request(run, workspace, policy, profile)
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
            raise KeymintError(
                "the policy names no subject exactly",
                where=Origin(str(policy)),
                help="attach a profile to a name without wildcards, or use 'keymint create NAME'",
                code="subjects-none",
            )
        # Processes begin with the authorities, which then sign the last.
        minted, authorities = plan_authorities(session, () if run.resumes else new_authority)
        minted = minted.then(plan_lists(session.after(minted), authorities))
        session = session.after(minted)
        create = partial(CreateStage, policy=acquired, force=force)
        build = partial(BuildStage, options=options, force=force, renew=renew and not run.resumes, policy=acquired)
        install = partial(InstallStage, authorities=authorities, prune=prune)
        proof = proof_stage(run, acquired, standard_only=document_options.allow_vendor_specific)
        subjects = create(session).subjects(names)
        if run.has_cluster:
            ahead = create(session)
            created = ahead.plan([ahead.package(name) for name in subjects])
            # Processes begin with what the cluster compiled.
            run.compile_elsewhere(session.after(created), subjects, options, prove=prove)
        run.workers.start(session, subjects, (create, build, install, *((proof,) if prove else ())))
        created = run.planned(create(session), subjects)
        session = session.after(created)
        names = (*names, *session.infrastructure())
        built = run.planned(build(session), names)
        session = session.after(built)
        installed = run.planned(install(session), names)
        if narrower := superseded(session, installed, asked=revoke_superseded):
            run.workers.close()
            revoking = plan_revocation(session, narrower, SUPERSEDED).plan
            first = plan.then(created).then(built).then(revoking)
            return reissued(
                run, inputs.after(plan).session(), first, names, prove=prove, new_authority=new_authority,
                options=options,
            )  # fmt: skip
        for stage in (created, built, minted, installed):
            plan = plan.then(stage)
        slips = policy_slips(session, (*created.steps, *built.steps), acquired)
        plan = plan.noting(*slips, *unknown_hints(options, document_options.hints, names))
        return proven(run, session, installed, names, proof, plan, strict=strict) if prove else plan

    def _profile_plan(inputs: Inputs) -> Plan:
        if not inputs.workspace.exists():
            plan = plan_init(inputs, profile.profile_type or DEFAULT_PROFILE_TYPE, request)
            refuse_unsupported(inputs.after(plan).session())
            return plan
        return plan_policy(inputs.session(), policy_path(run.setting.cwd / policy, inputs.workspace.profile))

    return run.carry_out(workspace, make_plan)
