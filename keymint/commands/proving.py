"""What installing asks of a proof: that every enclave is proven, before the first byte is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import click

from keymint.api import LoadedPolicy, Proof
from keymint.commands.common import Run
from keymint.errors import ExitCode, KeymintError, Severity
from keymint.plan.inputs import Inputs, LoadedProfile, Sources
from keymint.plan.model import Plan
from keymint.plan.prove import NO_PROVER, Proven, prove

PROVING_OPTIONS: Sequence[Callable[[Any], Any]] = (
    click.option(
        "--prove/--no-prove",
        default=True,
        show_default=True,
        help="Install nothing unless every document is proven to permit exactly what the policy says.",
    ),
)

standard_only_option = click.option(
    "--allow-vendor-specific",
    is_flag=True,
    help="Prove documents as the standard reads them only, as they were built with --allow-vendor-specific.",
)


def proven(
    run: Run,
    planned: Inputs,
    loaded: LoadedProfile,
    names: Sequence[str],
    sources: Sources,
    policy: LoadedPolicy,
    plan: Plan,
    *,
    standard_only: bool,
) -> Plan:
    """Return a plan whose enclaves are proven, with the record of that.

    Args:
        run: the verb under way.
        planned: the workspace as it will be.
        loaded: its profile.
        names: the packages that are installed.
        sources: the packages' files.
        policy: what the enclaves are held against.
        plan: what will be done.
        standard_only: vendors may differ from the standard.

    Raises:
        KeymintError: a claim about an enclave is refuted or unknown; exit code 3.
    """
    from keymint.commands.prove import diagnostics_of, effort_of  # noqa: PLC0415 - only when it is asked for

    found = prove(
        planned, loaded, names, sources, policy, effort_of(run), standard_only=standard_only,
        folder=lambda name: planned.workspace.build / name,
    )  # fmt: skip
    said = [diagnostic for enclave in found.enclaves for diagnostic in diagnostics_of(enclave)]
    standard = next(iter(found.assumptions), "")
    of_vendors = {enclave.subject for enclave in found.enclaves if _holds(enclave, standard)}
    refused = [
        replace(each, help=_with_mend(each.help, of_vendors=each.subject in of_vendors))
        for each in said
        if each.code != NO_PROVER
    ]
    if refused:
        # What is said of the plan often says why: an edit by hand, or a policy that changed.
        raise KeymintError.of([*plan.diagnostics, *refused], ExitCode.FINDINGS)
    unsupported = [replace(each, severity=Severity.WARNING) for each in said]
    return replace(plan, state=found.state, diagnostics=(*plan.diagnostics, *unsupported))


def _holds(enclave: Proven, standard: str) -> bool:
    """Tell whether an enclave is proven by the standard's reading, which a prover names first."""
    own = [claim for claim in enclave.claims if claim.model == standard]
    return bool(own) and all(claim.proof is Proof.PROVEN for claim in own)


def _with_mend(help_: str, *, of_vendors: bool) -> str:
    accept = "accept what vendors decide differently with --allow-vendor-specific, " if of_vendors else ""
    mend = f"nothing is installed; build it anew from the policy, {accept}or install it all the same with --no-prove"
    return f"{help_}; {mend}" if help_ else mend
