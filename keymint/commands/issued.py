# SPDX-License-Identifier: Apache-2.0
"""``keymint issued``: the register of issued certificates."""

from __future__ import annotations

import click

from keymint.commands.options import packages_argument
from keymint.commands.revoke import document
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.names import package_name, subject_of
from keymint.output.report import Report
from keymint.plan.register import complete_register


@verb()
@packages_argument
@click.option("--revoked", is_flag=True, help="Only certificates that were revoked.")
def issued(run: Run, names: tuple[str, ...], revoked: bool) -> Report:
    """List the certificates that were issued: serial number, subject, generation, dates, and whether it is revoked.

    NAME is a package [all], also one whose sources are gone. --json has the fingerprints of the keys as well.
    """
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
