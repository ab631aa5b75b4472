# SPDX-License-Identifier: Apache-2.0
"""``keymint create``: source packages from the policy, and what the owner accepts of what ROS packages ship."""

from __future__ import annotations

from comarmor.values import replace
from keymint.command_line.options import Names, names_group, valid_for_option
from keymint.command_line.stage_options import AcceptanceOptions, accept, acceptance_options
from keymint.command_line.verb import Report, Run, flag, verb
from keymint.errors import usage_error
from keymint.names import no_subject
from keymint.stages.create import packages_to_create
from keymint.stages.pipeline import CREATE, Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Action, Plan
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session
from keymint.workspace.shipped_profiles import plan_release


@verb(jobs=True, dry_run=True, yes=True, former={"trust_package": "--accept-package"})
def create(
    run: Run,
    names: Names = names_group(state=False),
    all_subjects: bool = flag("--all"),
    force: bool = flag("-f"),
    valid_for: str | None = valid_for_option,
    acceptance: AcceptanceOptions = acceptance_options,
) -> Report:
    """Create source packages in src/, one per subject, or update their rules from the policy.

    If a transport of the workspace needs further identities, their packages are created as well.

    NAME is a subject, e.g. /robot1/talker. Any subject that a profile applies to is allowed, even if the policy
    names it only by a wildcard. Manual edits of other documents are preserved.

    With --trust-package and without NAME and --all it only records what was accepted.

    Options:
        all_subjects: Create every subject that the policy names exactly.
        force: Replace the rules of a package even if they were edited manually.
    """
    if not names and not all_subjects and not acceptance.trust_package:
        raise usage_error("no subject is named", "name some, or use --all")
    run.workspace()

    def make_plan(session: Session) -> Plan:
        work = accept(Work(session), acceptance)
        if not names and not all_subjects:
            return work.plan
        policy = lazy_policy(work.session)
        work = work.then(plan_release(work.session, policy))
        every = packages_to_create(work.session, policy)
        named = names.packages(run, work.session, None, every, "name a subject of the policy") if names else ()
        subjects = dict.fromkeys([*named, *(every if all_subjects else ())])
        if not subjects:
            raise no_subject("name the subjects: keymint create /robot1/talker")
        asked = InstallRequest(force=force)
        request = Request(tuple(subjects), (CREATE,), asked, policy=policy, valid_for=valid_for or "")
        work = conduct(work, request, run.crew)
        from keymint.command_line.agreement import another_policy, confirmed_plan  # noqa: PLC0415 - not for 'provision'
        from keymint.stages.changed_rights import rights_of_sources  # noqa: PLC0415 - as above

        changed = work.of(CREATE).of_action(Action.UPDATED)
        work = replace(work, rights=tuple(rights_of_sources(work.session, sorted(changed))))
        return confirmed_plan(run, work, another_policy(run, session, policy), policy)

    return run.change(make_plan)
