# SPDX-License-Identifier: Apache-2.0
"""``keymint crl``: show the revocation lists, and issue them again."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from typing import Any

import click

from keymint.command_line import durations
from keymint.command_line.verb import verb
from keymint.errors import ExitCode, KeymintError
from keymint.life.revocation_lists_in_force import lists, loaded_lists
from keymint.life.workspace_register import complete_register, register_change
from keymint.names import subject_of
from keymint.output.report import Report, members
from keymint.run.run import Run
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import Work
from keymint.store.changes import Plan
from keymint.workspace.session import Session


@verb(dry_run=True)
@click.option(
    "--refresh", is_flag=True, help="Issue the lists again, with a higher number, and put them into all enclaves."
)
@click.option(
    "--rebuild",
    is_flag=True,
    help="Make the lost register of issued certificates again, although it cannot have all revocations.",
)
@click.option(
    "--valid-for",
    callback=durations.optional_validity,
    metavar="PERIOD",
    help="With --refresh, let the lists end after this time: 30d, 4w. Nodes with an expired list do not start.",
)
def crl(run: Run, refresh: bool, rebuild: bool, valid_for: timedelta | None) -> Report:
    """Show the revocation lists: number, dates, and revoked certificates.

    A list ends with its authority. An expired one would keep each node that has it from starting, so a shorter
    period must be asked for.
    """
    if valid_for is not None and not refresh:
        raise click.UsageError("--valid-for needs --refresh.")
    if not refresh and not rebuild:
        return _shown(run, run.session())

    def make_plan(session: Session) -> Plan:
        workspace = session.workspace
        first = Plan((), session.state)
        if rebuild:
            if session.tree.has_file(workspace.register):
                raise KeymintError(
                    "the register of issued certificates is there, so there is nothing to rebuild",
                    where=workspace.origin(workspace.register),
                    help="remove it first if it is the wrong one",
                    code="register-exists",
                    exit_code=ExitCode.USAGE,
                )
            register = complete_register(session, lossy=True)
            first = Plan((), session.state, first=register_change(session, register))
        end = None if valid_for is None else session.now + valid_for
        again = tuple(lists(session)) if refresh else ()
        return conduct(Work(session), Request((), change=first, refresh=again, list_end=end), run.crew).plan

    report = run.change(make_plan)
    return report if run.dry_run else _shown(run, run.session(), report)


def _shown(run: Run, session: Session, done: Report | None = None) -> Report:
    """Show the lists, after what was done."""
    register = complete_register(session, lossy=True)  # which names the subjects, as far as they are known
    subjects = {
        each.serial: subject_of(each.name) for each in register.certificates.values() if each.revoked and each.name
    }
    rows: list[dict[str, Any]] = []
    cells: list[list[str]] = []
    for name, found in loaded_lists(session).items():
        path = session.workspace.shown(session.workspace.revocation_list(name))
        head = [name, str(found.number), f"{found.this_update:%Y-%m-%d}", f"{found.next_update:%Y-%m-%d}"]
        cells += [
            [*head, f"{each.serial:x}", subjects.get(each.serial, "-"), f"{each.at:%Y-%m-%d}", each.reason]
            for each in found.revocations
        ] or [[*head, "-", "-", "-", "-"]]
        rows.append(
            {
                "authority": name,
                "file": path,
                **members(found, "number", "this_update", "next_update"),
                "revoked": [
                    {
                        "serial": f"{each.serial:x}",
                        "subject": subjects.get(each.serial),
                        **members(each, "at", "reason"),
                    }
                    for each in found.revocations
                ],
            }
        )
    if cells:
        run.console.table(["AUTHORITY", "NUMBER", "FROM", "UNTIL", "SERIAL", "SUBJECT", "REVOKED", "REASON"], cells)
    else:
        run.console.line("no revocation list: nothing was ever revoked")
    return replace(done or run.report(workspace=session.workspace), result={"lists": rows})
