# SPDX-License-Identifier: Apache-2.0
"""``keymint crl``: show the revocation lists, and issue them again."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import click

from comarmor.text import hexadecimal
from comarmor.values import replace
from keymint.authority.authority_files import issuers
from keymint.command_line.options import validity
from keymint.command_line.verb import Report, Run, flag, option, verb
from keymint.errors import Diagnostic, ExitCode, KeymintError
from keymint.life.revocation_lists_in_force import lists, loaded_lists
from keymint.life.workspace_register import complete_register, installed_lists, register_change
from keymint.names import subject_of
from keymint.output.report import members
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import Work
from keymint.store.changes import Plan
from keymint.workspace.session import Session


@verb(dry_run=True)
def crl(
    run: Run,
    refresh: bool = flag(),
    rebuild: bool = flag(),
    valid_for: timedelta | None = option(type=validity, metavar="PERIOD"),
) -> Report:
    """Show the revocation lists: number, dates, and revoked certificates.

    A list expires with its authority, unless --valid-for gives it a shorter period: a node with an expired list
    does not start.

    Options:
        refresh: Issue the lists again, with a higher number, and put them into all enclaves.
        rebuild: Make a lost register of issued certificates again from what is left; it may lack revocations.
        valid_for: With --refresh, let the lists end after this time: 30d, 4w. Nodes with an expired list do not start.
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
    found: list[dict[str, Any]] = [
        {
            "authority": name,
            "file": session.workspace.shown(session.workspace.revocation_list(name)),
            **members(each, "number", "this_update", "next_update"),
            "revoked": [
                {"serial": hexadecimal(one.serial), "subject": subjects.get(one.serial), **members(one, "at", "reason")}
                for one in each.revocations
            ],
        }
        for name, each in loaded_lists(session).items()
    ]
    columns = {"AUTHORITY": "authority", "NUMBER": "number", "FROM": "this_update", "UNTIL": "next_update"}
    of_revoked = {"SERIAL": "serial", "SUBJECT": "subject", "REVOKED": "at", "REASON": "reason"}
    done = done or run.report(workspace=session.workspace)
    if found:
        run.console.table(columns | of_revoked, [each | one for each in found for one in each["revoked"] or [{}]])
    elif any(any(installed_lists(session, authority)) for *_, authority in issuers(session)):
        run.console.line("no revocation list here, but installed enclaves have one")
        where, help_ = session.workspace.origin(session.workspace.public), "restore public/ and private/ from a backup"
        help_ += "; or remove private/register.sqlite3, and 'keymint crl --rebuild' takes over what the enclaves have"
        lost = Diagnostic.warning("register-outdated", "the list of the enclaves is gone", where, help_)
        done = replace(done, diagnostics=(*done.diagnostics, lost))
    else:
        run.console.line("no revocation list: nothing was ever revoked")
    return replace(done, result={"lists": found})
