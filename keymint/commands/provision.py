"""``keymint provision``: all stages in one go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from comarmor.errors import Origin
from keymint.commands.build_options import BUILD_OPTIONS, build_options
from keymint.commands.common import Run, verb
from keymint.commands.init import bootstrap_request
from keymint.commands.policy_slips import policy_slips
from keymint.commands.profile_options import (
    DEFAULT_PROFILE_TYPE,
    PROFILE_OPTIONS,
    add_options,
    new_authority_option,
    refuse_contradiction,
)
from keymint.commands.proving import PROVING_OPTIONS, proven
from keymint.errors import KeymintError
from keymint.output.report import Report
from keymint.plan.authorities import plan_authorities
from keymint.plan.bootstrap import plan_init, plan_policy, policy_path
from keymint.plan.build import plan_build
from keymint.plan.create import everything, plan_create, recall_policy
from keymint.plan.inputs import Inputs, Sources
from keymint.plan.install import plan_install
from keymint.plan.model import Plan


@verb(writes=True)
@click.argument("policy", type=click.Path(path_type=Path))
@add_options(PROFILE_OPTIONS)
@click.option("-f", "--force", is_flag=True, help="Discard edits by hand of permissions.xml and of built documents.")
@click.option("--prune", is_flag=True, help="Remove installed enclaves that have no source package any more.")
@click.option("--renew", is_flag=True, help="Mint new private keys; keys are never replaced otherwise.")
@add_options(BUILD_OPTIONS)
@new_authority_option
@add_options(PROVING_OPTIONS)
def provision(
    run: Run,
    policy: Path,
    profile_type: str | None,
    distro: str | None,
    domain: int | None,
    layout: str | None,
    subject_format: str | None,
    force: bool,
    prune: bool,
    renew: bool,
    allow_vendor_specific: bool,
    optimise: bool,
    hints: Path | None,
    new_authority: tuple[str, ...],
    prove: bool,
) -> Report:
    """From a ComArmor POLICY to a keystore in one go: init, create --all, build and install.

    All of it is planned and validated before the first byte is written. Run it again after every change of the
    policy: only what the change concerns is rebuilt and signed again, and no key is replaced. Nothing is installed
    unless it is proven to permit exactly what the policy says, for every name there is.
    """
    workspace = run.workspace_at(None)
    asked = {
        "profile-type": profile_type,
        "distro": distro,
        "domain": domain,
        "layout": layout,
        "subject-format": subject_format,
    }
    hinted = build_options(run, allow_vendor_specific=allow_vendor_specific, optimise=optimise, hints=hints)
    request = bootstrap_request(run, workspace, policy, distro, domain, layout, subject_format)
    if workspace.exists():
        refuse_contradiction(run, workspace, asked)

    def make_plan(inputs: Inputs) -> Plan:
        plan = _profile_plan(inputs)
        after = inputs.after(plan)
        loaded = after.profile()
        sources = Sources(run.plugins)
        acquired = recall_policy(after, loaded)
        names = everything(after, acquired)
        if not names:
            raise KeymintError(
                "the policy names no subject exactly",
                where=Origin(str(policy)),
                help="attach a profile to a name without wildcards, or use 'keymint create NAME'",
                code="subjects-none",
            )
        created = plan_create(after, loaded, acquired, names, sources, force=force)
        after = after.after(created)
        built = plan_build(after, loaded, names, sources, hinted.options, force=force, renew=renew)
        after = after.after(built)
        minted, authorities = plan_authorities(after, loaded, new_authority)
        after = after.after(minted)
        installed = plan_install(after, loaded, names, sources, authorities, prune=prune)
        for stage in (created, built, minted, installed):
            plan = plan.then(stage)
        slips = policy_slips(after, loaded, (*created.steps, *built.steps))
        plan = replace(plan, diagnostics=(*plan.diagnostics, *slips, *hinted.unknown(names)))
        if not prove:
            return plan
        after = after.after(installed)
        kept = installed.kept()
        within = tuple(name for name in names if name not in kept)
        return proven(run, after, loaded, within, sources, acquired, plan, standard_only=allow_vendor_specific)

    def _profile_plan(inputs: Inputs) -> Plan:
        if not inputs.workspace.exists():
            return plan_init(inputs, profile_type or DEFAULT_PROFILE_TYPE, request)
        return plan_policy(inputs, inputs.profile(), policy_path(run.setting.cwd / policy, inputs.workspace.profile))

    return run.carry_out(workspace, make_plan)
