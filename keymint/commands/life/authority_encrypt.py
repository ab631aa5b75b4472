# SPDX-License-Identifier: Apache-2.0
"""``keymint authority encrypt``: an authority's private key with a password, for a profile that asks for one later."""

from __future__ import annotations

from keymint.authority.authority_changes import plan_encryption
from keymint.command_line.options import authority_argument
from keymint.command_line.verb import verb
from keymint.output.report import Report
from keymint.run.run import Run


@verb(dry_run=True, of="authority")
@authority_argument
def command(run: Run, name: str) -> Report:
    """Encrypt the private key of an authority in private/, if the profile asks for BestAvailableEncryption.

    The key stays the same, so no enclave changes. The password comes from the environment variable that the profile
    names. Backups and copies keep the plain key: delete them, or replace the key with 'keymint authority replace'.
    """
    return run.change(lambda session: plan_encryption(session, name))
