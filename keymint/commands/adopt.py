# SPDX-License-Identifier: Apache-2.0
"""``keymint adopt``: a keystore that another tool made becomes a workspace."""

from __future__ import annotations

from pathlib import Path

import click

from keymint.adoption.reading import found_in
from keymint.commands.options import PATH
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.output.keystores import as_json, summary
from keymint.output.report import Report, findings_exit


@verb(dry_run=True)
@click.argument("keystore", type=PATH)
def adopt(run: Run, keystore: Path) -> Report:
    """Report on KEYSTORE, which another tool made: 'ros2 security', openssl, or a vendor's guide.

    \b
    keymint adopt demo_keystore                     reads it, and writes nothing

    For each enclave: whether its certificate, key and signed documents belong together, what they allow, until when,
    and who can read its key. No link is followed that leads out of KEYSTORE. Exit code 3: there are findings.
    """
    _, _, found = found_in(run.plugins, run.setting.cwd / keystore, str(keystore), run.setting.now)
    for line in summary(str(keystore), found, {}):
        run.console.line(line)
    return Report(run.verb, None, (), found.diagnostics, as_json(found, {}), findings_exit(found.diagnostics))
