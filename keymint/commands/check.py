# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: compare the installed keystore with its expected state."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

import click

from comarmor.errors import Diagnostic, Severity
from comarmor.text import counted
from keymint.check import check as find
from keymint.commands.durations import period
from keymint.commands.options import FILE, packages_argument
from keymint.commands.run import Run
from keymint.commands.user_files import write_outputs
from keymint.commands.verb import verb
from keymint.errors import KeymintError
from keymint.examine.not_examined import not_examined
from keymint.names import subject_of
from keymint.output.report import Report, findings_if, folded
from keymint.output.sarif import of_diagnostics
from keymint.output.sarif import sarif as sarif_log
from keymint.plan.policy import lazy_policy
from keymint.plan.policy_drift import uncreated
from keymint.session import Session


@verb()
@click.option("-j", "--jobs", type=click.IntRange(1, 256), metavar="N", help="Use N processes [all cores].")
@packages_argument
@click.option(
    "--within",
    callback=period,
    default="0d",
    metavar="PERIOD",
    help="Also report certificates and grants that expire within this time: 12h, 30d, 4w.",
)
@click.option("--sarif", type=FILE, metavar="FILE", help="Write the findings as SARIF 2.1.0.")
@click.option("--without-private", is_flag=True, help="Exit with 0 although you may not read all of private/.")
def check(run: Run, names: tuple[str, ...], within: timedelta, sarif: Path | None, without_private: bool) -> Report:
    """Compare installed enclaves with their expected state.

    Checks certificates, keys, signatures, schemas, dates, file modes, and whether the installed documents match the
    sources. Exit code 3: there are findings, or you may not read all of private/. NAME is a package [all].
    """
    session = run.session(auditing=True)
    chosen = run.names(session, names)
    with run.pool() as pool:
        diagnostics = find(session, chosen, within, pool)
    unexamined = tuple(not_examined(session))
    findings = folded((*diagnostics, *(() if names else _uncreated(session, chosen)), *unexamined))
    if sarif is not None:
        write_outputs(run, sarif, sarif_log("keymint check", {}, of_diagnostics(findings), run.typed))
    number = sum(finding.severity is not Severity.NOTE for finding in findings)
    more = f"; {len(unexamined)} not examined (-v says what)" if unexamined else ""
    run.console.line(f"checked {counted(len(chosen), 'enclave')}: {counted(number, 'finding')}{more}")
    result = {"checked": [subject_of(name) for name in chosen], "not_examined": len(unexamined)}
    exit_code = findings_if(number or (unexamined and not without_private))
    return run.report(result, findings, exit_code, workspace=session.workspace)


def _uncreated(session: Session, known: Sequence[str]) -> Sequence[Diagnostic]:
    """Return findings on subjects without a package, or on a policy that cannot be read."""
    try:
        return uncreated(session, lazy_policy(session), known)
    except KeymintError as error:
        return error.diagnostics
