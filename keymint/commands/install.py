"""``keymint install``: signs what was built and stages it."""

from __future__ import annotations

from collections.abc import Sequence

import click

from keymint.commands.build import no_packages
from keymint.commands.common import Run, complete_package, verb
from keymint.errors import ExitCode, KeymintError
from keymint.plan.authorities import plan_authorities
from keymint.plan.create import policy_changed
from keymint.plan.inputs import Inputs, LoadedProfile, Sources
from keymint.plan.install import plan_install
from keymint.plan.model import Plan
from keymint.report import Report
from keymint.state import State


@verb(writes=True)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
@click.option("--prune", is_flag=True, help="Remove installed enclaves that have no source package any more.")
@click.option(
    "--prove",
    is_flag=True,
    help="Install nothing unless every document is proven to permit exactly what the policy says (keymint prove).",
)
def install(run: Run, names: tuple[str, ...], prune: bool, prove: bool) -> Report:
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
        state = _proven(run, after.after(installed), loaded, chosen) if prove else installed.state
        return Plan(plan.steps + installed.steps, state, (*plan.diagnostics, *installed.diagnostics, *said))

    return run.carry_out(workspace, make_plan)


def _proven(run: Run, planned: Inputs, loaded: LoadedProfile, names: Sequence[str]) -> State:
    """Return the record of what was proven about enclaves that are planned.

    Raises:
        KeymintError: a claim about one is refuted or unknown.
    """
    from keymint.commands.prove import diagnostics_of, effort_of  # noqa: PLC0415 - only when it is asked for
    from keymint.plan.create import load_policy  # noqa: PLC0415
    from keymint.plan.prove import prove  # noqa: PLC0415

    policy = load_policy(planned, loaded)
    found = prove(planned, loaded, names, Sources(run.plugins), policy, effort_of(run), lambda _name: None)
    if refused := [said for enclave in found.enclaves for said in diagnostics_of(enclave)]:
        raise KeymintError.of(refused, ExitCode.FINDINGS)
    return found.state
