# SPDX-License-Identifier: Apache-2.0
"""``keymint authority import``: an authority's certificate from outside."""

from __future__ import annotations

from pathlib import Path

import click

from keymint.authority.authority_changes import plan_import
from keymint.command_line.authority_change import given_authority, issued_again
from keymint.command_line.options import FILE, authority_argument, flag_day_option
from keymint.command_line.verb import verb
from keymint.output.report import Report
from keymint.run.run import Run


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
    given = given_authority(run, certificate, key_file)
    return run.change(
        lambda session: issued_again(run, session, plan_import(session, name, given), name, flag_day=flag_day)
    )
