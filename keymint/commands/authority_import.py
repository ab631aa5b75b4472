# SPDX-License-Identifier: Apache-2.0
"""``keymint authority import``: an authority's certificate from outside."""

from __future__ import annotations

from pathlib import Path

import click

from keymint.changes import Plan
from keymint.commands.authority_change import issued_again, require_flag_day
from keymint.commands.options import FILE, authority_argument, flag_day_option
from keymint.commands.run import Run
from keymint.commands.user_files import read_input
from keymint.commands.verb import verb
from keymint.output.report import Report
from keymint.plan.authority_renewal import plan_import
from keymint.plan.given_authority import GivenAuthority
from keymint.session import Session


@verb(dry_run=True, of="authority")
@authority_argument
@click.argument("certificate", type=FILE)
@click.option("--key", "key_file", type=FILE, metavar="FILE", help="Its private key, which is copied into private/.")
@flag_day_option
def command(run: Run, name: str, certificate: Path, key_file: Path | None, flag_day: bool) -> Report:
    """Use the certificate of an authority that somebody else issued, as it is.

    CERTIFICATE is a PEM file. Its private key may stay elsewhere: then everything works here that needs no signature of
    it. Once enclaves are installed, the certificate must be for the key that they trust; another key is the matter of
    'keymint authority replace'.
    """
    key = read_input(run, key_file) if key_file else b""
    given = GivenAuthority(read_input(run, certificate), str(certificate), key, str(key_file or ""))

    def make_plan(session: Session) -> Plan:
        first = plan_import(session, name, given)
        if first.writes():
            require_flag_day(session, name, accepted=flag_day)
        return issued_again(run, session, first, name)

    return run.change(make_plan)
