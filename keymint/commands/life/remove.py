# SPDX-License-Identifier: Apache-2.0
"""``keymint remove``: packages that are not needed any more, with all that the workspace has of them."""

from __future__ import annotations

from keymint.command_line.options import Names, names_group
from keymint.command_line.verb import Report, Run, flag, verb
from keymint.commands.life.revoke import revocation_result, shown_revocation
from keymint.life.package_removal import REASON, certified_names, plan_removal, removable_names, require_unneeded
from keymint.names import subject_of
from keymint.stages.pipeline import Request, conduct
from keymint.stages.rollover_phases import in_step
from keymint.stages.work import Work
from keymint.store.changes import Action, Plan
from keymint.workspace.session import Session


@verb(dry_run=True, yes=True)
def remove(run: Run, names: Names = names_group(required=True), never_deployed: bool = flag()) -> Report:
    """Remove packages for good: sources, documents, key and enclave; their certificates are revoked as retired.

    Remove them from the policy first, or they would be made again. Every other enclave receives the revocation
    list; deploy and restart those that are listed. NAME is a package, or an enclave whose package is gone.

    A package that is made again under the same name gets a new key, and goes on with the next generation.

    Options:
        never_deployed: No robot ever had the enclave, so its certificate need not be revoked.
    """

    def make_plan(session: Session) -> Plan:
        there = removable_names(session)
        own = there.difference(session.infrastructure())  # no pattern finds what the transport needs
        hint = "'keymint status' lists what is here"
        chosen = () if run.resumes else names.packages(run, session, there | certified_names(session), own, hint)
        require_unneeded(session, chosen)
        told = names.confirm(run, "remove", chosen)
        removing = plan_removal(session, chosen, deployed=not never_deployed)
        plan = conduct(Work(session), Request((), change=removing.plan), run.crew).plan
        plan = in_step(run.crew, session, plan.noting(*told, *removing.diagnostics))
        gone = plan.of_action(Action.REMOVED)
        removed = [subject_of(name) for name in chosen if name in gone]
        run.outcome = {"removed": removed, **revocation_result(run, removing, plan, chosen)}
        run.lines = [*shown_revocation(run, removing, run.outcome, REASON)]
        return plan

    return run.change(make_plan)
