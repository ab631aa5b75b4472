"""``keymint install``: signs what was built and stages it."""

from __future__ import annotations

import click

from keymint.commands.build import no_packages
from keymint.commands.common import Run, complete_package, verb
from keymint.plan.authorities import plan_authorities
from keymint.plan.create import policy_changed
from keymint.plan.inputs import Inputs, Sources
from keymint.plan.install import plan_install
from keymint.plan.model import Plan
from keymint.report import Report


@verb(writes=True)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
@click.option("--prune", is_flag=True, help="Remove installed enclaves that have no source package any more.")
def install(run: Run, names: tuple[str, ...], prune: bool) -> Report:
    """Sign what is in build/ and stage it in install/, one complete enclave per subject.

    A certificate or a signed document whose content and signer did not change is left as it is. Each enclave can
    be copied to a robot alone; no authority's private key is ever staged. NAME is a package; by default all.
    """
    workspace = run.workspace()

    def make_plan(inputs: Inputs) -> Plan:
        loaded = inputs.profile()
        plan, authorities = plan_authorities(inputs, loaded)
        after = inputs.after(plan)
        chosen = run.names(inputs, names)
        installed = plan_install(after, loaded, chosen, Sources(run.plugins), authorities, prune=prune)
        said = policy_changed(inputs, loaded) if chosen else (no_packages(inputs),)
        return Plan(plan.steps + installed.steps, installed.state, (*plan.diagnostics, *installed.diagnostics, *said))

    return run.carry_out(workspace, make_plan)
