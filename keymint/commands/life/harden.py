# SPDX-License-Identifier: Apache-2.0
"""``keymint harden``: mend what a keystore that was taken over lacks, one step at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import click

from comarmor.text import first_few
from comarmor.values import replace
from keymint.api import Validity
from keymint.authority.authorities import authority_named
from keymint.authority.authority_changes import plan_renewal
from keymint.command_line.options import Names, flag_day_option, names_group
from keymint.command_line.verb import Report, Run, argument, flag, verb
from keymint.commands.life.authority_change import issued_again
from keymint.errors import KeymintError
from keymint.examine.weaknesses import OpenStep, Weakness, open_steps
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import Work
from keymint.store.changes import Action, Plan, Step, folder_changes
from keymint.workspace.installed_enclaves import with_sources
from keymint.workspace.session import Session


@verb(dry_run=True)
def harden(
    run: Run,
    step: str | None = argument(type=click.Choice([str(each) for each in Weakness]), required=False),
    names: Names = names_group(state=False),
    applied: bool = flag("--apply"),
    flag_day: bool = flag_day_option,
) -> Report:
    """List the steps that are open and what each costs; --apply does one of them.

    \b
    authority      a second authority signs documents: the one that issues identities no longer does
    identifiers    the certificates of authorities get key identifiers and the right to sign revocation lists
    names          a unique RDN in the subject names of the packages NAME [all]

    Private keys in the workspace already have mode 0600; on robots, use 'chmod 600'.

    Options:
        applied: Do the step; without it, see its cost and change nothing.
    """
    if applied:
        run.recover(run.workspace())
    session = run.session()
    if names and step not in {None, Weakness.NAMES}:
        raise click.UsageError(f"the step {step!r} concerns all packages; name none.")
    wanted = names.packages(run, session)
    steps = [
        replace(each, concerns=left) if each.step == Weakness.NAMES else each
        for each in open_steps(session)
        if (left := tuple(name for name in each.concerns if name in wanted)) or each.step != Weakness.NAMES
    ]
    chosen = [each for each in steps if step in {None, str(each.step)}]
    run.console.lines(f"{each.step}: {first_few(each.concerns)}: {each.cost}" for each in chosen)
    if not chosen:
        run.console.line(f"{step}: nothing to do" if step else "nothing to do: no step is open")
    result = {"steps": [asdict(each) for each in steps]}
    if not applied or not chosen or run.resumes:
        report = run.finish(session.workspace) if run.interrupted else run.report(workspace=session.workspace)
        return replace(report, result=result)
    if step is None:
        raise click.UsageError("--apply needs a STEP: each has a cost of its own.")

    def make_plan(session: Session) -> Plan:
        match step:
            case Weakness.NAMES:
                only = chosen[0].concerns
                return conduct(Work(session), Request(only, change=plan_names(session, only)), run.crew).plan
            case Weakness.AUTHORITY:
                work = Work(session).then(plan_authority(session, chosen[0], flag_day=flag_day))
                return conduct(work, Request(with_sources(session)), run.crew).plan
            case _:
                work = Work(session)
                for name in chosen[0].concerns:
                    renewal = plan_renewal(work.session, name)
                    work = work.then(issued_again(run, work.session, renewal, name, flag_day=flag_day))
                return work.plan

    return replace(run.change(make_plan), result=result)


STAGE = "harden"


def plan_names(session: Session, names: Sequence[str]) -> Plan:
    """Plan a unique RDN in the subject names of some packages; their sources change only.

    Raises:
        KeymintError: the sources are written in another way than Keymint writes them.
    """
    steps = []
    for name in names:
        new = session.package_type.with_unique_name(session.profile, name, session.package_files(name))
        if new is None:
            raise _unsupported(session, f"packages of the type {session.profile.package_type!r}")
        changes = folder_changes(session.tree, session.workspace.src / name, new)
        steps.append(Step(STAGE, name, Action.UPDATED if changes else Action.UNCHANGED, changes, "unique subject name"))
    return Plan(tuple(steps), session.state)


def plan_authority(session: Session, step: OpenStep, *, flag_day: bool) -> Plan:
    """Plan another authority for the signature of documents, which outlives them; the profile changes only.

    Args:
        session: the workspace and its profile.
        step: the step, which concerns the authority that signs them now.
        flag_day: the user accepts that old and new enclaves do not work together.

    Raises:
        KeymintError: the user does not accept that; or the profile is written in another way than Keymint writes it, or
            has such an authority.
    """
    if not flag_day:
        help_ = "plan a common restart of all robots and add --flag-day"
        raise KeymintError(f"this is {step.cost}", help=help_, code="authority-flag-day")
    profile, former = session.profile, step.concerns[0]
    name = session.profile_type.SIGNER
    if not name:
        raise _unsupported(session, f"profiles of the type {profile.profile_type!r}")
    if name in {each.name for each in profile.authorities}:
        raise KeymintError(
            f"the profile has an authority {name!r} already", where=session.profile_marker(),
            help="rename that authority, or name it as the signer in package.defaults/", code="authority-exists",
        )  # fmt: skip

    def plan(validity: Validity | None) -> Plan:
        edited = session.profile_type.with_own_signer(profile, former, validity)
        changes = folder_changes(session.tree, session.workspace.profile, edited)
        return Plan((Step(STAGE, "", Action.UPDATED, changes, f"{name} signs in place of {former}"),), session.state)

    of_defaults = authority_named(session.after(plan(None)).session(), name).certificate.validity
    grants = [session.package(each).grant for each in session.packages()]
    ends = [each.validity.not_after for each in grants if each.validity and each.issuer == former]
    end = max(ends, default=of_defaults.not_after)
    return plan(Validity(of_defaults.not_before, end) if end > of_defaults.not_after else None)


def _unsupported(session: Session, what: str) -> KeymintError:
    message = f"{what} cannot be changed by Keymint"
    return KeymintError(message, where=session.profile_marker(), help="change them by hand", code="harden-unsupported")
