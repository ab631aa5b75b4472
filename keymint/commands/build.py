"""``keymint build``: unsigned documents, and keys."""

from __future__ import annotations

from pathlib import Path

import click

from comarmor.errors import Diagnostic, Severity
from keymint.commands.build_options import BUILD_OPTIONS, build_options
from keymint.commands.common import Run, complete_package, verb
from keymint.commands.policy_slips import policy_slips
from keymint.commands.profile_options import add_options
from keymint.output.report import Report
from keymint.plan.build import plan_build
from keymint.plan.create import policy_changed
from keymint.plan.inputs import Inputs, Sources
from keymint.plan.model import Plan


@verb(writes=True)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
@click.option("-f", "--force", is_flag=True, help="Rebuild everything, and discard edits by hand.")
@click.option("--renew", is_flag=True, help="Mint new private keys; keys are never replaced otherwise.")
@click.option(
    "--unsigned",
    is_flag=True,
    help="Stop at the unsigned documents for an edit by hand, as build always does; here for scripts to say so.",
)
@add_options(BUILD_OPTIONS)
def build(
    run: Run,
    names: tuple[str, ...],
    force: bool,
    renew: bool,
    unsigned: bool,
    allow_vendor_specific: bool,
    optimise: bool,
    hints: Path | None,
) -> Report:
    """Build unsigned documents in build/, and mint a key for each subject that has none.

    All packages are validated before the first byte is written. Nothing is signed: 'keymint install' does that,
    so a document may be edited by hand in between. Permissions are rewritten into a smaller form, which is proven to
    permit what the rules say; its size is shown beside that of the plain form. NAME is a package; by default all.
    """
    del unsigned  # what it asks for is what this verb does
    workspace = run.workspace()
    hinted = build_options(run, allow_vendor_specific=allow_vendor_specific, optimise=optimise, hints=hints)

    def make_plan(inputs: Inputs) -> Plan:
        loaded = inputs.profile()
        chosen = run.names(inputs, names)
        plan = plan_build(inputs, loaded, chosen, Sources(run.plugins), hinted.options, force=force, renew=renew)
        said = policy_changed(inputs, loaded, Sources(run.plugins)) if chosen else (no_packages(inputs),)
        said = (*said, *policy_slips(inputs, loaded, plan.steps))
        return Plan(plan.steps, plan.state, (*plan.diagnostics, *said, *hinted.unknown(run.names(inputs, ()))))

    return run.carry_out(workspace, make_plan)


def no_packages(inputs: Inputs) -> Diagnostic:
    """Return the warning for a source space without packages."""
    return Diagnostic(
        "packages-none",
        Severity.WARNING,
        f"no packages in {inputs.workspace.shown(inputs.workspace.src)}",
        None,
        "run 'keymint create --all'",
    )
