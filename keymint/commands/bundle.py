# SPDX-License-Identifier: Apache-2.0
"""``keymint bundle``: what a robot needs of its installed enclave, in one signed file."""

from __future__ import annotations

from pathlib import Path

import click

from comarmor.errors import Origin
from comarmor.patterns.glob import parse
from comarmor.patterns.matching import matches
from comarmor.patterns.tokens import SPECIAL
from comarmor.text import did_you_mean
from keymint.changes import Plan
from keymint.commands.bundle_files import bundle_output_option, require_output, write_bundles
from keymint.commands.options import complete_package
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.errors import KeymintError
from keymint.names import package_name
from keymint.output.report import Report
from keymint.plan.authorities import plan_authorities
from keymint.plan.bundles import MadeBundle, plan_bundles
from keymint.plan.install import is_current
from keymint.session import Inputs, Session


@verb(dry_run=True)
@click.argument("names", nargs=-1, required=True, metavar="NAME|PATTERN...", shell_complete=complete_package)
@bundle_output_option
def bundle(run: Run, names: tuple[str, ...], output: Path | None) -> Report:
    """Write installed enclaves into bundles, one for each, which robots take with 'keymint accept'.

    A bundle is signed by the authority of the enclave's certificate, and numbered, so that a robot never goes back. It
    has the private key if this workspace made it; then keep it as secret as the key. NAME is an installed package, and
    PATTERN matches the names of several: '/robot1/*'.
    """
    workspace = run.workspace()
    made: list[MadeBundle] = []

    def make_plan(inputs: Inputs) -> Plan:
        session = inputs.session()
        chosen = _chosen(session, names)
        require_output(run, output, len(chosen))
        plan, authorities = plan_authorities(session)
        after = session.after(plan)
        chains = {name: each.chain for name, each in authorities.items()}
        for name in chosen:
            if plan.writes() or not is_current(after, name, chains):
                raise KeymintError(
                    f"the enclave /{name} is not installed as its sources and authorities are now",
                    where=Origin(workspace.shown(session.enclaves / name)),
                    help=f"run 'keymint build {name}' and 'keymint install {name}' first",
                    code="not-installed",
                )
        planned, bundles = plan_bundles(after, dict.fromkeys(chosen), authorities)
        made[:] = bundles
        return plan.then(planned)

    report = run.carry_out(workspace, make_plan)
    result = {"bundles": write_bundles(run, output, made)}
    return Report(run.verb, workspace, (), report.diagnostics, result, report.exit_code, dry_run=run.dry_run)


def _chosen(session: Session, given: tuple[str, ...]) -> tuple[str, ...]:
    """Return the packages that the user named, or whose names match a pattern.

    Raises:
        KeymintError: there is none.
    """
    known, chosen = session.packages(), dict[str, None]()
    for each in given:
        if SPECIAL.search(each):
            found = [name for name in known if matches(parse(each), f"/{name}")]
        else:
            name = package_name(each)
            found = [name] if name in known else []
        if not found:
            raise KeymintError(
                f"no package is called {each!r} in {session.workspace.shown(session.workspace.src)}",
                help=did_you_mean(each, [f"/{name}" for name in known], "'keymint status' lists them"),
                code="package-unknown",
            )
        chosen.update(dict.fromkeys(found))
    return tuple(chosen)
