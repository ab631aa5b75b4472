"""``keymint build``: unsigned documents, and keys."""

from __future__ import annotations

import click

from comarmor.errors import Diagnostic, Severity
from keymint.changes import Plan
from keymint.commands.build_options import build_options
from keymint.commands.options import (
    DocumentOptions,
    complete_package,
    document_options,
    renew_option,
)
from keymint.commands.policy_slips import policy_slips
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.output.report import Report
from keymint.plan.build import plan_build
from keymint.plan.policy_drift import policy_changed
from keymint.session import Inputs


@verb(jobs=True, dry_run=True)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
@click.option("-f", "--force", is_flag=True, help="Rebuild everything; discard manual edits.")
@renew_option
@document_options
def build(
    run: Run,
    names: tuple[str, ...],
    force: bool,
    renew: bool,
    document_options: DocumentOptions,
) -> Report:
    """Build unsigned documents in build/, and create a key for each subject that has none.

    All packages are validated before anything is written. Documents stay unsigned until 'keymint install', so you may
    edit them in between. Permissions are rewritten into a smaller form that is proven equivalent; both sizes are
    shown. NAME is a package [all].
    """
    workspace = run.workspace()
    hinted = build_options(run, document_options)

    def make_plan(inputs: Inputs) -> Plan:
        session = inputs.session()
        chosen = run.names(inputs, names)
        plan = plan_build(session, chosen, hinted.options, force=force, renew=renew)
        said = policy_changed(session) if chosen else (no_packages(inputs),)
        said = (*said, *policy_slips(session, plan.steps))
        return Plan(plan.steps, plan.state, (*plan.diagnostics, *said, *hinted.unknown(run.names(inputs, ()))))

    return run.carry_out(workspace, make_plan)


def no_packages(inputs: Inputs) -> Diagnostic:
    """Return the warning that the source space has no packages."""
    return Diagnostic(
        "packages-none",
        Severity.WARNING,
        f"no packages in {inputs.workspace.shown(inputs.workspace.src)}",
        None,
        "run 'keymint create --all'",
    )
