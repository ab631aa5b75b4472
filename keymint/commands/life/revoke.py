# SPDX-License-Identifier: Apache-2.0
"""``keymint revoke``: end the certificates of subjects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click

from comarmor.errors import Severity
from comarmor.text import counted
from keymint.command_line.options import complete_package, prove_option
from keymint.command_line.verb import verb
from keymint.errors import KeymintError
from keymint.life.package_issuance import Revoking, plan_revocation
from keymint.life.register import REASONS, SUPERSEDED, IssuedCertificate
from keymint.names import package_name, subject_list, subject_of
from keymint.output.report import Report, members
from keymint.run.run import Run
from keymint.stages.pipeline import Request, conduct, updated_packages
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import INSTALLED
from keymint.workspace.session import Session


@verb(dry_run=True)
@click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=complete_package)
@click.option(
    "--reason",
    type=click.Choice(REASONS),
    required=True,
    help="superseded: the same key gets a new certificate. All others: nothing is issued for this key again.",
)
@prove_option
def revoke(run: Run, names: tuple[str, ...], reason: str, prove: bool) -> Report:
    """Revoke the certificates of some packages.

    Their serial numbers go to the revocation list of the authority, which every enclave gets as crl.pem, and the
    generation in their sources rises, so that permissions that were signed before fit no later certificate. A list
    takes effect when the peers restart. NAME is a package, also one whose sources are gone.

    With the reason superseded a new certificate for the same key is installed. Otherwise the enclave is removed, until
    'keymint renew --rekey NAME' makes a new key.
    """
    chosen = tuple(dict.fromkeys(map(package_name, names)))
    done: list[tuple[Revoking, Plan]] = []

    def make_plan(session: Session) -> Plan:
        revoking = plan_revocation(session, () if run.resumes else chosen, reason)
        request = Request(revoking.packages, options=InstallRequest(prove=prove), change=revoking.plan)
        plan = conduct(Work(session), request, run.crew).plan
        if revoking.skipped and not plan.writes():
            raise KeymintError.of([replace(each, severity=Severity.ERROR) for each in revoking.skipped])
        done[:] = [(revoking, plan)]
        return plan.noting(*revoking.skipped, *revoking.diagnostics)

    report = run.change(make_plan)
    ((revoking, plan),) = done
    peers = [name for name in updated_packages(plan) if name not in chosen]
    names_again = [name for name in updated_packages(plan) if name in chosen]
    say = run.console.line
    for each in revoking.certificates:
        word = "would revoke" if run.dry_run else "revoked  "
        say(f"{word} {subject_of(each.name)} serial {each.serial:x}, generation {each.generation}, {reason}")
    if peers:
        say(
            f"deploy and restart {counted(len(peers), 'enclave')}: {subject_list(peers)}; a node that runs keeps its "
            "old list, and until its restart accepts the revoked certificate; connections made before go on until then"
        )
    shared = [
        run.workspace().shown(change.folder / file)
        for step in plan.steps
        if step.stage == INSTALLED and not step.package
        for change in step.changes
        for file in change.written
    ]
    if shared:
        say(f"deploy {', '.join(shared)}, and restart what reads it")
    if names_again:
        say(f"deploy and restart with the new certificate: {subject_list(names_again)}")
    elif reason != SUPERSEDED and revoking.packages:
        say(f"nothing is issued for {subject_list(revoking.packages)} until 'keymint renew --rekey'")
    result = {
        "revoked": [document(each) for each in revoking.certificates],
        "restart": [subject_of(name) for name in peers],
        "shared": shared,
        "issued_again": [subject_of(name) for name in names_again],
    }
    return replace(report, result=result)


def document(each: IssuedCertificate) -> dict[str, Any]:
    """Return the entry of a certificate for ``--json``; serial numbers are hexadecimal."""
    return {
        "serial": f"{each.serial:x}",
        "authority": each.authority,
        "subject": subject_of(each.name) if each.name else None,
        **members(each, "generation", "not_before", "not_after", "key", "rights", "revoked", "reason"),
    }
