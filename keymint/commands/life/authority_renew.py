# SPDX-License-Identifier: Apache-2.0
"""``keymint authority renew``: an authority's certificate again, for the same key."""

from __future__ import annotations

from keymint.authority.authority_changes import plan_renewal
from keymint.command_line.authority_change import issued_again
from keymint.command_line.options import authority_argument, flag_day_option
from keymint.command_line.verb import verb
from keymint.output.report import Report
from keymint.run.run import Run


@verb(dry_run=True, of="authority")
@authority_argument
@flag_day_option
def command(run: Run, name: str, flag_day: bool) -> Report:
    """Issue an authority's certificate again for the same key and name: it begins now, and is valid as long as before.

    All enclaves get the new certificate. If the authority issues identities, robots with the old certificate and robots
    with the new one work together. If it signs documents, these are signed again, and vendors let subjects that hold
    different certificates of it not communicate: that needs --flag-day.
    """
    return run.change(lambda session: issued_again(run, session, plan_renewal(session, name), name, flag_day=flag_day))
