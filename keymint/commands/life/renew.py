# SPDX-License-Identifier: Apache-2.0
"""``keymint renew``: certificates and permissions that are due, before they expire."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from comarmor.text import quantity
from comarmor.values import replace
from keymint.command_line.agreement import confirmed_plan
from keymint.command_line.options import Names, names_group, prove_option, threshold
from keymint.command_line.verb import Report, Run, findings_if, flag, option, verb
from keymint.errors import Diagnostic, KeymintError, Severity, UnconfirmedError
from keymint.life import renewal_schedule
from keymint.life.package_issuance import plan_issuance
from keymint.life.renewal_schedule import AuthorityDue, Due, Schedule, installed_terms, schedule
from keymint.life.terms import Threshold, iso_time
from keymint.life.workspace_register import with_enclaves
from keymint.names import subject_list, subject_of
from keymint.run.run import exit_code_of
from keymint.stages.documents import built_documents, refuse_edits
from keymint.stages.package_status import packages_of, refuse_new_authorities, renewable_packages
from keymint.stages.pipeline import Request, conduct, updated_packages
from keymint.stages.rollover_phases import DEFERRED, STAGE, in_step
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Action, Plan
from keymint.workspace.session import Session

NOT_HERE = "authority-key-missing"
"""Code of the error that an authority cannot sign, since its key is elsewhere."""


@verb(dry_run=True, yes=True)
def renew(
    run: Run,
    names: Names = names_group(),
    threshold: Threshold = option(type=threshold, default="66%", show_default=True, metavar="PART"),
    rekey: bool = flag(),
    prove: bool = prove_option,
) -> Report:
    """Renew certificates and permissions that are due, for the same keys; nothing else changes.

    A package is due when its certificate, permissions or revocation list is, whichever comes first. NAME is a
    package, also one that is not due; on the day of its issue there is nothing to renew [all that are due]. Deploy
    the renewed enclaves and restart their processes before the old documents expire; no other process needs a
    restart.

    An authority that is due is reported; only 'keymint authority renew' renews it.

    \b
    Exit codes, e.g. for cron:
      0 renewed, or nothing is due
      1 something that is due was not renewed
      3 a person must renew an authority, a second keystore, or make a key elsewhere; with --dry-run: something is due

    Options:
        threshold: Due after this part of the validity, or if it ends within this time: 66%, 30d.
        rekey: Also make new keys; needed for a package whose key was revoked.
    """
    is_left = False

    def make_plan(session: Session) -> Plan:
        nonlocal is_left
        packages = names.packages(run, session, threshold=threshold)
        told = names.confirm(run, "rekey", packages) if rekey else ()
        enclaves = with_enclaves(session, packages, named=bool(names))
        terms = installed_terms(session, enclaves)
        due = schedule(session, terms, threshold)
        shorter = () if threshold.left is None else [
            subject_of(name) for name, own in terms.items() if any(each.length < 2 * threshold.left for each in own)
        ]  # fmt: skip
        if names:
            by_state = {each.name: each for each in due.enclaves} if names.state == "due" else {}
            chosen = tuple(by_state.get(name, Due(name)) for name in packages)
            due = Schedule(chosen, due.lists, due.authorities, due.following)
        rekeys = rekey and not run.resumes
        plan, is_left = _renewal(run, session, due, rekey=rekeys, prove=prove, alone=not names)
        if shorter:
            capped = "the time of --threshold is more than half of a validity; due after that half:"
            run.lines = (*run.lines, f"{capped} {subject_list(shorter)}")
        return plan.noting(*told)

    return run.change(make_plan, lambda plan: exit_code_of(plan) or findings_if(is_left))


def _renewal(run: Run, session: Session, due: Schedule, *, rekey: bool, prove: bool, alone: bool) -> tuple[Plan, bool]:
    """Plan what is due, and say what is done and why, what to restart, and what is next.

    Args:
        run: the run.
        session: the workspace and its profile.
        due: what is due.
        rekey: make new keys.
        prove: require proofs.
        alone: nobody named the packages, so the defects of some do not keep the others from being renewed.

    Returns:
        The plan, and whether there is something that only a person can do, or with ``--dry-run`` something is due.

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
        except UnconfirmedError:
            raise
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
    for step in plan.steps if not alone else ():  # on the day of issue, when its sources do not change
        if step.action is Action.KEPT and step.package in names:
            refuse_edits(session, step.package, built_documents(session, step.package))
    findings = [*requests, *map(_authority_due, due.authorities)]
    plan = in_step(run.crew, session, plan.noting(*findings, *dict.fromkeys(errors)))
    after = session.after(plan)
    rows = [
        {
            **_document(each, "subject"),
            "until": min((term.last for term in renewal_schedule.enclave_terms(after, each.name)), default=None),
            "key_elsewhere": bool(session.issuance(each.name).public_key),
        }
        for each in due.enclaves
        if each.name in frozenset(names)
    ]
    changed = updated_packages(plan)
    if due.following is not None and due.following.name in changed:  # it was named, and its dates are others now
        due = replace(due, following=None)
    new = frozenset(map(subject_of, changed))
    result: dict[str, Any] = {
        "renewed": [each for each in rows if each["subject"] in new],
        "unchanged": [each for each in rows if each["subject"] not in new],
        "waiting": [_document(each, "subject") for each in due.enclaves if each.name in waiting],
        "lists": [_document(each, "authority") for each in due.lists],
        "authorities_due": [
            {"authority": each.name, "ends": each.end, "subjects": [subject_of(name) for name in each.packages]}
            for each in due.authorities
        ],
        "next": _document(due.following, "subject") if due.following else None,
    }
    of_late = [_document(each, "authority") for each in waiting_lists]
    run.lines = _lines(run, due, result, of_late, plan)
    is_due = run.dry_run and (due.lists or waiting_lists or len(due.enclaves) > len(result["unchanged"]))
    of_person = findings or any(each.code == DEFERRED for each in plan.diagnostics)
    result["unchanged"] = [each["subject"] for each in result["unchanged"]]
    run.outcome = result
    return plan, bool(of_person or is_due)


def _document(due: Due, whose: str) -> dict[str, Any]:
    """Return what is due, and why; ``whose`` is the member that has its name."""
    name = due.name if whose == "authority" else subject_of(due.name)
    return {whose: name, "why": due.why and due.why.what, "ends": due.why and due.why.last, "due": due.after}


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
    decided = {name: renewal_schedule.renewal_issuance(session, name) for name in names}
    begins = {name: new for name, new in decided.items() if rekey or new != session.issuance(name)}
    first = plan_issuance(session, run.verb, begins)
    ends = [renewal_schedule.list_end(session, each) for each in due.lists]
    request = Request(
        names,
        options=InstallRequest(prove=prove, rekey=frozenset(names if rekey else ())),
        change=first,
        refresh=[each.name for each in due.lists],
        list_end=None if None in ends else max(filter(None, ends), default=None),
    )
    plan = confirmed_plan(run, conduct(Work(session), request, run.crew))
    refuse_new_authorities(session, plan)
    return plan


def _authority_due(due: AuthorityDue) -> Diagnostic:
    """Return the finding on an authority that is due."""
    first = (*due.issuers[::-1], due.name)[0]
    message = f"the authority {due.name!r} is due: it expires on {iso_time(due.end)}"
    if due.packages:
        message += f", and what it signs for {quantity(len(due.packages), 'enclave')} expires with it"
    if due.issuers:
        message += f"; so does its issuer {due.issuers[0]!r}"
    return Diagnostic.warning("authority-due", message, None, f"run 'keymint authority renew {first}'")


def _lines(
    run: Run, due: Schedule, result: Mapping[str, Any], waiting_lists: Sequence[Mapping[str, Any]], plan: Plan
) -> Sequence[str]:
    """Return what was done and why, what to restart, and what is next.

    Args:
        run: the run.
        due: what is due.
        result: for ``--json``, but what stays unchanged in the form of what is renewed.
        waiting_lists: the revocation lists that wait for a signature.
        plan: what is done.
    """
    would = "would renew" if run.dry_run else "renewed"
    lines = [
        f"{would} {each['subject']}: {_why(each)}; now in force until {_date(each['until'])}"
        for each in result["renewed"]
    ]
    lines += [
        f"{each['subject']}: nothing to renew: a new certificate would have the same dates; "
        f"in force until {_date(each['until'])}"
        for each in result["unchanged"]
    ]
    lines += [f"{each['subject']} not renewed, a key for it is not here: {_why(each)}" for each in result["waiting"]]
    lines += [f"{would} the revocation list of {each['authority']}: {_why(each)}" for each in result["lists"]]
    lines += [
        f"revocation list of {each['authority']} not renewed, its key is not here: {_why(each)}"
        for each in waiting_lists
    ]
    own = {each["subject"] for each in result["renewed"]}
    changed = [*map(subject_of, updated_packages(plan))]
    staged = [subject_of(step.package) for step in plan.steps if step.stage == STAGE and step.package and step.writes()]
    for text, subjects in {
        "deploy and restart before the old documents expire:": [each for each in changed if each in own],
        "deploy the new revocation list and restart before the old one expires:": [
            each for each in changed if each not in own
        ],
        "deploy install.next/ as well, which was staged by 'authority replace':": staged,
        "the key is not here: 'keymint bundle' carries the new documents to": [
            each["subject"] for each in result["renewed"] if each["key_elsewhere"]
        ],
    }.items():
        if subjects:
            lines.append(f"{text} {subject_list(subjects)}")
    following = result["next"]
    if following and following["due"]:
        none = "" if due.enclaves else "nothing is due; "
        lines.append(f"{none}next is {following['subject']}, from {iso_time(following['due'])} on")
    elif not lines:
        lines.append("nothing is due")
    return lines


def _why(due: Mapping[str, Any]) -> str:
    if due["why"] is None or due["due"] is None:
        return "as requested"
    verb = "end" if due["why"] == renewal_schedule.PERMISSIONS else "ends"
    return f"its {due['why']} {verb} on {_date(due['ends'])}, so it has been due since {_date(due['due'])}"


def _date(moment: datetime | None) -> str:
    return iso_time(moment) if moment else "-"
