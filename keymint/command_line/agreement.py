# SPDX-License-Identifier: Apache-2.0
"""What a plan takes from subjects: a dry run shows it, and the user must agree before it is carried out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from comarmor.text import first_few, quantity
from comarmor.values import replace
from keymint.analysis.permission_changes import PermissionChange, rule_changes
from keymint.analysis.policy_diff import SubjectChanges
from keymint.analysis.symbolic_search import QueryBudget
from keymint.api import LoadedPolicy
from keymint.errors import Diagnostic, Origin
from keymint.names import subject_list, subject_of
from keymint.output.differences import as_text, differences_json, summary
from keymint.run.run import Run
from keymint.stages.work import Work
from keymint.store.changes import Action, Plan
from keymint.workspace.installed_enclaves import INSTALLED, enclave_names
from keymint.workspace.policy_loading import recorded_profiles, recorded_subjects
from keymint.workspace.session import Session

FEWEST, SHARE = 5, 10
"""The user is asked if at least so many subjects lose something, and these are at least one of so many."""
_LINES = 40
"""Lines about rights that a person reads before an answer."""


def confirmed_plan(
    run: Run, work: Work, reasons: Sequence[Diagnostic] = (), policy: LoadedPolicy | None = None
) -> Plan:
    """Return the plan of some work, once the user agrees to what it takes away; see :meth:`Run.confirm`.

    A dry run shows who gains and loses which right, any other run how many. What cannot be read stops nobody, unless
    nothing is left after it: an enclave that was damaged must stay easy to restore.

    Args:
        run: the run; its result gets the rights.
        work: the work.
        reasons: what else the user must agree to.
        policy: the policy, for what new subjects gain; by default the rules of their packages.

    Raises:
        UnconfirmedError: nobody agreed.
    """
    plan, session = work.plan, work.session
    changes = _of_all_build_types(work.rights)
    created = plan.of_action(Action.CREATED).intersection(session.packages())
    if run.dry_run and {*enclave_names(session)}.difference(session.infrastructure(), created):
        for name in created.difference(session.infrastructure()):
            rules = (policy.rules(subject_of(name)) if policy else None) or session.package(name).grant.rules
            gains = tuple(rule_changes((), rules.rules, QueryBudget()))
            changes[subject_of(name)] = SubjectChanges(subject_of(name), None, False, True, gains)
    rights = [changes[subject] for subject in sorted(changes)]
    run.result["rights"] = differences_json(rights, run.typed)

    def show() -> None:
        if rights:
            lines = [*as_text(rights, run.place)]
            most = len(lines) if run.dry_run or run.verbosity > 0 else _LINES
            cut = (
                [f"… and {quantity(len(lines) - most, 'line')} more; --dry-run shows all"] if len(lines) > most else []
            )
            run.console.lines((*lines[:most], *cut, summary(rights)))

    asked = (*reasons, *_losses(work, rights, "" if run.dry_run else "--dry-run shows which"))
    told = run.confirm(asked, show)
    if run.dry_run or (run.verbosity > 0 and (run.yes or not asked)):
        show()
    elif rights and (run.yes or not asked):
        run.console.line(f"{summary(rights)} (-v shows which; --dry-run does so before)")
    return plan.noting(*told, *_unread(rights))


def _of_all_build_types(found: Iterable[SubjectChanges]) -> dict[str, SubjectChanges]:
    """Return the changes by subject; what documents of several build types say is said once, without a build type."""
    subjects: dict[str, SubjectChanges] = {}
    for each in found:
        before = subjects.get(each.subject, replace(each, changes=()))
        changes: dict[PermissionChange, PermissionChange] = {}
        for one in (*before.changes, *each.changes):
            content = replace(one, where=None, word="", build_type="")
            changes[content] = replace(changes[content], build_type="") if content in changes else one
        subjects[each.subject] = replace(before, after=before.after and each.after, changes=tuple(changes.values()))
    return subjects


def another_policy(
    run: Run, session: Session, policy: LoadedPolicy, path: Path | None = None
) -> tuple[Diagnostic, ...]:
    """Return what the user must agree to if another policy takes the place of the one that a workspace has packages of.

    A policy that moved, or has another name, is the same one: what counts is which profiles it has. That of the same
    path is another one only if it names other subjects as well, since its profiles may have new names.

    Args:
        run: the run.
        session: the workspace before it.
        policy: the policy.
        path: its path, if the workspace named another one.
    """
    old, new = recorded_profiles(session), {*policy.root_profiles()}
    is_known = len(old & new) * 2 >= min(len(old), len(new))  # also if the record does not tell
    if is_known or (path is None and not recorded_subjects(session).isdisjoint(policy.subjects())):
        return ()
    names = (first_few(sorted(each)) for each in (new, old))
    message = "is another policy than the workspace has: its profiles are {}, and those before are {}".format(*names)
    where = Origin(run.typed(str(path or session.profile.policies[0].path)))
    help_ = "is it the right file, and the right workspace?"
    return (Diagnostic.warning("policy-replaced", message, where, help_),)


def _losses(work: Work, rights: Sequence[SubjectChanges], more: str) -> Iterator[Diagnostic]:
    """Yield what the user must agree to; the second text says what shows more."""
    if stripped := [each.subject for each in rights if not each.after]:
        of_whom = stripped[0] if len(stripped) == 1 else f"{len(stripped)} subjects: {subject_list(stripped)}"
        help_ = "is it the right policy? name them in it; 'keymint remove NAME' is for those that are gone"
        yield Diagnostic.warning("subject-stripped", f"this takes all rights from {of_whom}", None, help_)
    losing = [each.subject for each in rights if any(not one.gains for one in each.changes)]
    if len(losing) >= FEWEST:
        new = {step.package for step in work.of(INSTALLED).steps if step.action is Action.CREATED}
        total = len({*enclave_names(work.session)}.difference(work.session.infrastructure(), new))
        if len(losing) * SHARE >= total:
            message = f"this takes rights from {len(losing)} of {quantity(total, 'subject')}: {subject_list(losing)}"
            yield Diagnostic.warning("rights-lost", message, None, more)


def _unread(rights: Sequence[SubjectChanges]) -> Iterator[Diagnostic]:
    """Yield a warning about subjects of which it is not known what they gain or lose, if there are any."""
    if unknown := {each.subject: one.unknown for each in rights for one in each.changes if one.unknown}:
        message = f"what {subject_list([*unknown])} gain or lose is unknown: {next(iter(unknown.values()))}"
        yield Diagnostic.warning("rights-unread", message, None, "'keymint check' examines what is installed")
