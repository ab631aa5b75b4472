# SPDX-License-Identifier: Apache-2.0
"""``keymint issued``: the register of issued certificates."""

from __future__ import annotations

from functools import partial

import click

from keymint.command_line.options import packages_argument
from keymint.command_line.verb import verb
from keymint.commands.life.revoke import document
from keymint.errors import KeymintError
from keymint.life.workspace_register import complete_register, register_change
from keymint.names import package_name, subject_of
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.store.changes import Action, Plan, Step
from keymint.workspace.session import Session

STAGE = "register"


@verb(dry_run=True)
@packages_argument
@click.option("--revoked", is_flag=True, help="Only certificates that were revoked.")
@click.option(
    "--accept",
    is_flag=True,
    help="Accept that holders may present documents of NAME that were signed before and permit more than the policy, "
    "until these end: 'check', 'prove' and 'status' mention them no more.",
)
def issued(run: Run, names: tuple[str, ...], revoked: bool, accept: bool) -> Report:
    """List the certificates that were issued: serial number, subject, generation, dates, and whether it is revoked.

    NAME is a package [all], also one whose sources are gone. --json has the fingerprints of the keys as well.
    """
    if accept:
        return run.change(partial(_accepted, names))
    session = run.session()
    register = complete_register(session)
    chosen = {package_name(name) for name in names}
    entries = [
        each
        for each in register.certificates.values()
        if (not chosen or each.name in chosen) and (each.revoked or not revoked)
    ]
    cells = [
        [
            subject_of(each.name) if each.name else "-",
            str(each.generation),
            f"{each.serial:x}",
            f"{each.not_after:%Y-%m-%d}",
            f"revoked {each.revoked:%Y-%m-%d} ({each.reason})"
            if each.revoked
            else "expired"
            if each.not_after < session.now
            else "in force",
        ]
        for each in entries
    ]
    run.console.table(["SUBJECT", "GENERATION", "SERIAL", "NOT AFTER", "STATE"], cells)
    if not cells:
        run.console.line("no certificates")
    return run.report({"certificates": [document(each) for each in entries]}, workspace=session.workspace)


def _accepted(names: tuple[str, ...], session: Session) -> Plan:
    """Plan that the documents of some packages that were signed before stay good with the owner's consent.

    Raises:
        KeymintError: no package is named, or no document of one is known.
    """
    chosen = tuple(dict.fromkeys(package_name(name) for name in names))
    register = complete_register(session)
    if missing := [name for name in chosen if name not in {each.name for each in register.rights}] or not chosen:
        who = f"of {subject_of(missing[0])} is known" if isinstance(missing, list) else "is accepted unless you name it"
        raise KeymintError(f"no document {who}", help="'keymint check' names the packages", code="package-unknown")
    after = register.with_accepted(chosen, session.now)
    writes = register_change(session, after)
    action = Action.UPDATED if writes else Action.UNCHANGED
    detail = "earlier documents are accepted"
    steps = (Step(STAGE, name, action, writes if name == chosen[0] else (), detail) for name in chosen)
    return Plan(tuple(steps), session.state)
