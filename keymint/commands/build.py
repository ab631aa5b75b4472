"""``keymint build``: unsigned documents, and keys."""

from __future__ import annotations

import click

from keymint.api import BuildOptions
from keymint.commands.common import Run, complete_package, verb
from keymint.errors import Diagnostic, Severity
from keymint.plan.build import plan_build
from keymint.plan.create import policy_changed
from keymint.plan.inputs import Inputs, Sources
from keymint.plan.model import Plan
from keymint.report import Report


@verb(writes=True)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
@click.option("-f", "--force", is_flag=True, help="Build anew, also over documents that were edited by hand.")
@click.option("--renew", is_flag=True, help="Mint new private keys; keys are never replaced otherwise.")
@click.option(
    "--unsigned",
    is_flag=True,
    help="Stop at the unsigned documents for an edit by hand, as build always does; here for scripts to say so.",
)
@click.option(
    "--allow-vendor-specific",
    is_flag=True,
    help="Turn into warnings what DDS vendors would decide differently.",
)
def build(
    run: Run, names: tuple[str, ...], force: bool, renew: bool, unsigned: bool, allow_vendor_specific: bool
) -> Report:
    """Build unsigned documents in build/, and mint a key for each subject that has none.

    All packages are validated before the first byte is written. Nothing is signed: 'keymint install' does that,
    so a document may be edited by hand in between. NAME is a package; by default all of them.
    """
    del unsigned  # what it asks for is what this verb does
    workspace = run.workspace()

    def make_plan(inputs: Inputs) -> Plan:
        loaded = inputs.profile()
        chosen = run.names(inputs, names)
        options = BuildOptions(allow_vendor_specific=allow_vendor_specific)
        plan = plan_build(inputs, loaded, chosen, Sources(run.plugins), options, force=force, renew=renew)
        said = policy_changed(inputs, loaded) if chosen else (no_packages(inputs),)
        return Plan(plan.steps, plan.state, (*plan.diagnostics, *said))

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
