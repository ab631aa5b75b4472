# SPDX-License-Identifier: Apache-2.0
"""``keymint init``: create a workspace."""

from __future__ import annotations

from pathlib import Path

from keymint.authority.authorities import plan_authorities
from keymint.command_line.options import DEFAULT_PROFILE_TYPE
from keymint.command_line.stage_options import ProfileOptions, bootstrap_request, profile_options, refuse_contradiction
from keymint.command_line.verb import PATH, Report, Run, argument, path_option, verb
from keymint.stages.create import plan_init, refuse_unsupported
from keymint.stages.work import Work
from keymint.store.changes import Action, Plan, Step
from keymint.workspace.policy_loading import foreign_policy
from keymint.workspace.session import Inputs


@verb(jobs=True, dry_run=True)
def init(
    run: Run,
    folder: Path | None = argument(metavar="[WORKSPACE]", required=False, type=PATH),
    policy: Path | None = path_option(metavar="PATH"),
    profile: ProfileOptions = profile_options,
) -> Report:
    """Create a workspace: a profile with conservative defaults, and two certificate authorities.

    \b
    Then write your policy in profile/comarmor.d/, where talker_listener.xml is an example, and run
        keymint create --all && keymint build && keymint install

    Options:
        policy: ComArmor file or directory that becomes the policy of the workspace [the talker/listener example].
    """
    workspace = run.workspace_at(folder)
    if workspace.exists():
        refuse_contradiction(run, workspace, profile, policy)
        return run.carry_out(workspace, _again)
    request = bootstrap_request(run, workspace, policy, profile)
    foreign = foreign_policy(run.plugins, [run.setting.cwd / policy]) if policy is not None else None
    if foreign is not None and foreign.imported:
        raise foreign.refusal(run.typed(str(foreign.path)))

    def make_plan(inputs: Inputs) -> Plan:
        profile_type = profile.profile_type or DEFAULT_PROFILE_TYPE
        work = Work.after(inputs, plan_init(inputs, profile_type, request, profile.distro, run.setting.cwd))
        refuse_unsupported(work.session)
        return work.then(plan_authorities(work.session)[0]).plan

    return run.carry_out(workspace, make_plan)


def _again(inputs: Inputs) -> Plan:
    """Plan the missing authorities of an existing workspace."""
    plan = plan_authorities(inputs.session())[0]
    done = Step("init", "", Action.UNCHANGED, (), "workspace profile")
    return Plan((done, *plan.steps), plan.state, plan.diagnostics)
