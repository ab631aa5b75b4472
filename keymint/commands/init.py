"""``keymint init``: create a workspace."""

from __future__ import annotations

from pathlib import Path

import click

from comarmor.errors import Origin
from keymint.api import Bootstrap
from keymint.changes import Action, Plan, Step
from keymint.commands.options import DEFAULT_PROFILE_TYPE, ProfileOptions, profile_options
from keymint.commands.profile_options import refuse_contradiction
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.errors import KeymintError
from keymint.output.report import Report
from keymint.plan.authorities import plan_authorities
from keymint.plan.bootstrap import plan_init, policy_path
from keymint.session import Inputs
from keymint.workspace import Workspace


@verb(jobs=True, dry_run=True)
@click.argument("folder", metavar="[WORKSPACE]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--policy",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="ComArmor file or directory that becomes the policy of the workspace [the talker/listener example].",
)
@profile_options
def init(
    run: Run,
    folder: Path | None,
    policy: Path | None,
    profile: ProfileOptions,
) -> Report:
    """Create a workspace: a profile with conservative defaults, and two certificate authorities.

    \b
    Then write your policy in profile/comarmor.d/, where talker_listener.xml is an example, and run
        keymint create --all && keymint build && keymint install
    """
    workspace = run.workspace_at(folder)
    if workspace.exists():
        refuse_contradiction(run, workspace, profile, policy)
        return _again(run, workspace)
    request = bootstrap_request(run, workspace, policy, profile)

    def make_plan(inputs: Inputs) -> Plan:
        plan = plan_init(inputs, profile.profile_type or DEFAULT_PROFILE_TYPE, request)
        return plan.then(plan_authorities(inputs.after(plan).session())[0])

    return run.carry_out(workspace, make_plan)


def _again(run: Run, workspace: Workspace) -> Report:
    """Create the missing authorities of an existing workspace."""

    def make_plan(inputs: Inputs) -> Plan:
        plan = plan_authorities(inputs.session())[0]
        done = Step("init", "", Action.UNCHANGED, (), "workspace profile")
        return Plan((done, *plan.steps), plan.state, plan.diagnostics)

    return run.carry_out(workspace, make_plan)


def bootstrap_request(run: Run, workspace: Workspace, policy: Path | None, profile: ProfileOptions) -> Bootstrap:
    """Return the request for a new profile.

    Raises:
        KeymintError: the policy does not exist.
    """
    if policy is not None and not (run.setting.cwd / policy).exists():
        raise KeymintError(
            "no such file or folder",
            where=Origin(str(policy)),
            help="name a ComArmor policy",
            code="policy-missing",
        )
    environment = run.setting.environment
    return Bootstrap(
        name=workspace.root.name or "workspace",
        policy=policy_path(run.setting.cwd / policy, workspace.profile) if policy else "",
        distro=profile.distro or environment.get("ROS_DISTRO") or "jazzy",
        domain=profile.domain or 0,
        layout=profile.layout or "",
        subject_format=profile.subject_format or "unique",
        now=run.setting.now,
    )
