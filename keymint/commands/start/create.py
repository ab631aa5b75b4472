# SPDX-License-Identifier: Apache-2.0
"""``keymint create``: source packages from the policy."""

from __future__ import annotations

from keymint.command_line.accepted_packages import AcceptanceOptions, accept, acceptance_options
from keymint.command_line.options import valid_for_option
from keymint.command_line.verb import Report, Run, argument, flag, verb
from keymint.errors import usage_error
from keymint.names import no_subject, package_name
from keymint.stages.create import packages_to_create
from keymint.stages.pipeline import CREATE, Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session
from keymint.workspace.shipped_profiles import plan_release


@verb(jobs=True, dry_run=True)
def create(
    run: Run,
    names: tuple[str, ...] = argument(nargs=-1, metavar="[NAME]..."),
    all_subjects: bool = flag("Create every subject that the policy names exactly.", "--all"),
    force: bool = flag("Replace the rules of a package even if they were edited manually.", "-f"),
    valid_for: str | None = valid_for_option,
    acceptance: AcceptanceOptions = acceptance_options,
) -> Report:
    """Create source packages in src/, one per subject, or update their rules from the policy.

    If a transport of the workspace needs further identities, their packages are created as well.

    NAME is a subject, e.g. /robot1/talker. Any subject that a profile applies to is allowed, even if the policy
    names it only by a wildcard. Manual edits of other documents are preserved.

    With --accept-package and without NAME and --all it only records what was accepted.
    """
    if not names and not all_subjects and not acceptance.accept_package:
        raise usage_error("no subject is named", "name some, or use --all")
    run.workspace()
    named = [package_name(name) for name in names]

    def make_plan(session: Session) -> Plan:
        work = accept(Work(session), acceptance)
        if not names and not all_subjects:
            return work.plan
        policy = lazy_policy(work.session)
        work = work.then(plan_release(work.session, policy))
        subjects = dict.fromkeys([*named, *(packages_to_create(work.session, policy) if all_subjects else ())])
        if not subjects:
            raise no_subject("name the subjects: keymint create /robot1/talker")
        asked = InstallRequest(force=force)
        request = Request(tuple(subjects), (CREATE,), asked, policy=policy, valid_for=valid_for or "")
        return conduct(work, request, run.crew).plan

    return run.change(make_plan)
