# SPDX-License-Identifier: Apache-2.0
"""``keymint renew``: certificates and permissions that are due, before they expire."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

import click

from comarmor.errors import Diagnostic, Severity
from comarmor.text import counted
from comarmor.values import dataclass
from keymint.command_line import durations
from keymint.command_line.options import packages_argument, prove_option
from keymint.command_line.verb import verb
from keymint.errors import ExitCode, KeymintError
from keymint.life.package_issuance import plan_issuance
from keymint.life.renewal_schedule import (
    PERMISSIONS,
    AuthorityDue,
    Due,
    Schedule,
    enclave_terms,
    installed_terms,
    list_end,
    renewal_issuance,
    schedule,
)
from keymint.life.terms import Threshold, iso_time
from keymint.life.workspace_register import with_enclaves
from keymint.names import subject_list, subject_of
from keymint.output.report import Report, findings_if
from keymint.run.run import Run, exit_code_of
from keymint.stages.package_status import packages_of, refuse_new_authorities, renewable_packages
from keymint.stages.pipeline import Request, conduct, updated_packages
from keymint.stages.rollover_phases import DEFERRED, STAGE, in_step
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.session import Session

NOT_HERE = "authority-key-missing"
"""Code of the error that an authority cannot sign, since its key is elsewhere."""


@verb(dry_run=True)
@packages_argument
@click.option(
    "--threshold",
    callback=durations.threshold,
    default="66%",
    show_default=True,
    metavar="PART",
    help="Due after this part of the validity, or if it ends within this time: 66%, 30d.",
)
@click.option("--rekey", is_flag=True, help="Also make new keys; the way back for a package whose key is barred.")
@prove_option
def renew(run: Run, names: tuple[str, ...], threshold: Threshold, rekey: bool, prove: bool) -> Report:
    """Renew certificates and permissions that are due, for the same keys; nothing else changes.

    Due is what the certificate, the permissions or the revocation list of an enclave say, whichever comes first. NAME
    is a package, which is renewed in any case [all that are due]. Deploy the renewed enclaves and restart their
    processes before the old documents end; all others go on as they are.

    An authority is reported when it is due, and never renewed on the way.

    \b
    Exit codes, e.g. for cron:
      0 renewed, or nothing is due
      1 something that is due was not renewed
      3 a person must renew an authority, a second keystore, or make a key elsewhere; with --dry-run: something is due
    """
    done: list[_Renewal] = []

    def make_plan(session: Session) -> Plan:
        packages = run.names(session, names)
        due = schedule(session, installed_terms(session, with_enclaves(session, packages, names)), threshold)
        if names:
            due = Schedule(tuple(map(Due, packages)), due.lists, due.authorities, due.following)
        renewal = _renewal(run, session, due, rekey=rekey and not run.resumes, prove=prove, alone=not names)
        done[:] = [renewal]
        return renewal.plan

    report = run.change(make_plan, lambda plan: _exit_code(run, done[-1], plan))
    renewal = done[-1]
    run.console.lines(_lines(run, renewal))
    return replace(report, result=_result(renewal))


@dataclass(frozen=True, slots=True)
class _Renewed:
    """A package that is renewed: why, when it ends then, and whether its key is elsewhere."""

    due: Due
    now: datetime | None
    elsewhere: bool


@dataclass(frozen=True, slots=True)
class _Renewal:
    """What is due and what is done about it.

    Attributes:
        schedule: what is due.
        plan: what is done.
        renewed: what is renewed by it.
        unchanged: what was named, and stays as it is: a renewal would give it the dates that it has.
        waiting: the enclaves that are due and wait for the key of an authority, which is not here.
        waiting_lists: the revocation lists that wait for it.
        needs_person: there is something that only a person can do.
    """

    schedule: Schedule
    plan: Plan
    renewed: tuple[_Renewed, ...]
    unchanged: tuple[_Renewed, ...]
    waiting: tuple[Due, ...]
    waiting_lists: tuple[Due, ...]
    needs_person: bool


def _renewal(run: Run, session: Session, due: Schedule, *, rekey: bool, prove: bool, alone: bool) -> _Renewal:
    """Plan what is due.

    Args:
        run: the run.
        session: the workspace and its profile.
        due: what is due.
        rekey: make new keys.
        prove: require proofs.
        alone: nobody named the packages, so the defects of some do not keep the others from being renewed.

    Raises:
        KeymintError: nothing that is due can be renewed, or not all that was named.
    """
    names, state, requests, errors = renewable_packages(session, [each.name for each in due.enclaves], rekey=rekey)
    if errors and not alone:
        raise KeymintError.of(errors)
    session = session.after(Plan((), state))
    plan = Plan((), session.state)
    waiting: set[str] = set()
    waiting_lists: tuple[Due, ...] = ()
    while names or due.lists:
        try:
            plan = _issued_again(run, session, due, names, rekey=rekey, prove=prove)
            break
        except KeymintError as error:
            if {each.code for each in error.diagnostics} == {NOT_HERE}:
                severity = Severity.WARNING if run.dry_run else Severity.ERROR
                errors += (replace(each, severity=severity) for each in error.diagnostics)
                late, late_lists = _waiting(session, due, names, error)
                waiting |= late
                names = [name for name in names if name not in late]
                due = replace(due, lists=tuple(each for each in due.lists if each not in late_lists))
                waiting_lists += late_lists
                continue
            defective = packages_of(session, error.diagnostics, names)
            errors += error.diagnostics
            if not alone or not defective:
                raise KeymintError.of(tuple(dict.fromkeys(errors))) from error
            names = [name for name in names if name not in defective]
    findings = [*requests, *map(_authority_due, due.authorities)]
    plan = in_step(run.crew, session, plan.noting(*findings, *dict.fromkeys(errors)))
    after = session.after(plan)
    done = frozenset(names)
    taken = [each for each in due.enclaves if each.name in done]
    rows = [_Renewed(each, _end(after, each.name), bool(session.issuance(each.name).public_key)) for each in taken]
    changed = frozenset(updated_packages(plan))
    if due.following is not None and due.following.name in changed:  # it was named, and its dates are others now
        due = replace(due, following=None)
    return _Renewal(
        due,
        plan,
        tuple(each for each in rows if each.due.name in changed),
        tuple(each for each in rows if each.due.name not in changed),
        tuple(each for each in due.enclaves if each.name in waiting),
        waiting_lists,
        needs_person=bool(findings) or any(each.code == DEFERRED for each in plan.diagnostics),
    )


def _waiting(
    session: Session, due: Schedule, names: Sequence[str], error: KeymintError
) -> tuple[frozenset[str], tuple[Due, ...]]:
    """Return the packages and the revocation lists that wait for the keys whose files an error names.

    It is all of them if nothing can do without these keys.
    """
    files = {each.where.file for each in error.diagnostics if each.where}
    here = {
        each.name
        for each in session.profile.authorities
        if session.workspace.shown(session.workspace.authority_key(each.name)) not in files
    }
    packages = {name: session.package(name) for name in names}
    late = frozenset(
        name for name, package in packages.items() if not {package.identity.issuer, package.grant.issuer} <= here
    )
    lists = tuple(each for each in due.lists if each.name not in here)
    return (late, lists) if late or lists else (frozenset(names), due.lists)


def _issued_again(run: Run, session: Session, due: Schedule, names: Sequence[str], *, rekey: bool, prove: bool) -> Plan:
    """Plan new certificates and permissions of some packages, and the revocation lists that are due."""
    first = plan_issuance(session, run.verb, {name: renewal_issuance(session, name) for name in names})
    ends = [list_end(session, each) for each in due.lists]
    request = Request(
        names,
        options=InstallRequest(prove=prove, renew=rekey),
        change=first,
        refresh=[each.name for each in due.lists],
        list_end=None if None in ends else max(filter(None, ends), default=None),
    )
    plan = conduct(Work(session), request, run.crew).plan
    refuse_new_authorities(session, plan)
    return plan


def _end(session: Session, name: str) -> datetime | None:
    return min((each.last for each in enclave_terms(session, name)), default=None)


def _authority_due(due: AuthorityDue) -> Diagnostic:
    """Return the finding on an authority that is due."""
    first = (*due.issuers[::-1], due.name)[0]
    message = f"the authority {due.name!r} is due: it ends on {iso_time(due.end)}"
    if due.packages:
        message += f", and what it signs for {counted(len(due.packages), 'enclave')} ends with it"
    if due.issuers:
        message += f"; so does its issuer {due.issuers[0]!r}"
    return Diagnostic.warning("authority-due", message, None, f"run 'keymint authority renew {first}'")


def _exit_code(run: Run, renewal: _Renewal, plan: Plan) -> ExitCode:
    due_lists = (*renewal.schedule.lists, *renewal.waiting_lists)
    is_due = run.dry_run and (due_lists or len(renewal.schedule.enclaves) > len(renewal.unchanged))
    return exit_code_of(plan) or findings_if(renewal.needs_person or is_due)


def _lines(run: Run, renewal: _Renewal) -> Sequence[str]:
    """Return what was done and why, what to restart, and what is next."""
    would = "would renew" if run.dry_run else "renewed"
    lines = [
        f"{would} {subject_of(each.due.name)}: {_why(each.due)}; now in force until {_date(each.now)}"
        for each in renewal.renewed
    ]
    lines += [
        f"{subject_of(each.due.name)} stays as it is: a renewal would give it the dates that it has; "
        f"in force until {_date(each.now)}"
        for each in renewal.unchanged
    ]
    lines += [f"waits for a signature: {subject_of(each.name)}: {_why(each)}" for each in renewal.waiting]
    lines += [f"{would} the revocation list of {each.name}: {_why(each)}" for each in renewal.schedule.lists]
    lines += [
        f"waits for a signature: the revocation list of {each.name}: {_why(each)}" for each in renewal.waiting_lists
    ]
    own = {each.due.name for each in renewal.renewed}
    changed = updated_packages(renewal.plan)
    if ready := [name for name in changed if name in own]:
        lines.append(f"deploy and restart before the old documents end: {subject_list(ready)}")
    if others := [name for name in changed if name not in own]:
        lines.append(f"deploy the new revocation list and restart before the old one ends: {subject_list(others)}")
    if staged := [
        step.package for step in renewal.plan.steps if step.stage == STAGE and step.package and step.writes()
    ]:
        lines.append(f"deploy install.next/ as well, which was staged by 'authority replace': {subject_list(staged)}")
    if elsewhere := [each.due.name for each in renewal.renewed if each.elsewhere]:
        lines.append(f"the key is not here: 'keymint bundle' carries the new documents to {subject_list(elsewhere)}")
    following = renewal.schedule.following
    if following is not None and following.after is not None:
        none = "" if renewal.renewed or renewal.schedule.enclaves else "nothing is due; "
        lines.append(f"{none}next is /{following.name}, from {iso_time(following.after)} on")
    elif not lines:
        lines.append("nothing is due")
    return lines


def _why(due: Due) -> str:
    if due.why is None or due.after is None:
        return "as you asked"
    verb = "end" if due.why.what == PERMISSIONS else "ends"
    return f"its {due.why.what} {verb} on {_date(due.why.last)}, so it was due from {_date(due.after)} on"


def _date(moment: datetime | None) -> str:
    return iso_time(moment) if moment else "-"


def _result(renewal: _Renewal) -> dict[str, Any]:
    def dates(due: Due) -> dict[str, Any]:
        why = due.why
        return {"why": why.what if why else None, "ends": why.last if why else None, "due": due.after}

    following = renewal.schedule.following
    return {
        "renewed": [
            {
                "subject": subject_of(each.due.name),
                **dates(each.due),
                "until": each.now,
                "key_elsewhere": each.elsewhere,
            }
            for each in renewal.renewed
        ],
        "unchanged": [subject_of(each.due.name) for each in renewal.unchanged],
        "waiting": [{"subject": subject_of(each.name), **dates(each)} for each in renewal.waiting],
        "lists": [{"authority": each.name, **dates(each)} for each in renewal.schedule.lists],
        "authorities_due": [
            {"authority": each.name, "ends": each.end, "subjects": [subject_of(name) for name in each.packages]}
            for each in renewal.schedule.authorities
        ],
        "next": {"subject": f"/{following.name}", **dates(following)} if following else None,
    }
