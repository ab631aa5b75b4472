# SPDX-License-Identifier: Apache-2.0
"""``keymint revoke``: end the certificates of subjects."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import click

from comarmor.text import quantity
from comarmor.values import replace
from keymint.command_line.options import Names, names_group, prove_option
from keymint.command_line.verb import Report, Run, option, verb
from keymint.commands.life.issued import certificate_json
from keymint.errors import KeymintError, Severity
from keymint.life.package_issuance import Revoking, plan_revocation
from keymint.life.register import REASONS, SUPERSEDED
from keymint.life.workspace_register import complete_register
from keymint.names import subject_list, subject_of
from keymint.stages.pipeline import Request, conduct, updated_packages
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.installed_enclaves import INSTALLED
from keymint.workspace.session import Session


@verb(dry_run=True, yes=True)
def revoke(
    run: Run,
    names: Names = names_group(required=True),
    reason: str = option(type=click.Choice(REASONS), required=True),
    prove: bool = prove_option,
) -> Report:
    """Revoke the certificates of some packages.

    Adds their serial numbers to the revocation list of the authority, which every enclave receives as crl.pem, and
    raises the generation in their sources: permissions signed before the revocation do not match any later
    certificate. A peer applies the list when it restarts. NAME is a package, also one whose sources are gone.

    With the reason superseded a new certificate for the same key is installed. Otherwise the enclave is removed, until
    'keymint renew --rekey NAME' makes a new key.

    Options:
        reason: superseded: the same key gets a new certificate. All others: nothing is issued for this key again.
    """

    def make_plan(session: Session) -> Plan:
        certified = {each.name for each in complete_register(session, lossy=True).certificates.values() if each.name}
        chosen = names.packages(run, session, None, certified)
        told = names.confirm(run, "revoke", chosen)
        revoking = plan_revocation(session, () if run.resumes else chosen, reason)
        request = Request(revoking.packages, options=InstallRequest(prove=prove), change=revoking.plan)
        plan = conduct(Work(session), request, run.crew).plan
        if revoking.skipped and not plan.writes():
            raise KeymintError.of([replace(each, severity=Severity.ERROR) for each in revoking.skipped])
        again = [subject_of(name) for name in updated_packages(plan) if name in chosen]
        run.outcome = {**revocation_result(run, revoking, plan, chosen), "issued_again": again}
        run.lines = [*shown_revocation(run, revoking, run.outcome, reason)]
        return plan.noting(*told, *revoking.skipped, *revoking.diagnostics)

    return run.change(make_plan)


def revocation_result(run: Run, revoking: Revoking, plan: Plan, chosen: Collection[str]) -> dict[str, Sequence[Any]]:
    """Return what was revoked, and what to deploy and restart, for ``--json``.

    Args:
        run: the run.
        revoking: the revocation.
        plan: what is done.
        chosen: the packages that it is about.
    """
    return {
        "revoked": [certificate_json(each) for each in revoking.certificates],
        "restart": [subject_of(name) for name in updated_packages(plan) if name not in chosen],
        "shared": [
            run.workspace().shown(f"{change.folder}/{file}")
            for step in plan.steps
            if step.stage == INSTALLED and not step.package
            for change in step.changes
            for file in change.written
        ],
    }


def shown_revocation(run: Run, revoking: Revoking, result: Mapping[str, Sequence[Any]], reason: str) -> Iterator[str]:
    """Yield what was revoked, and what to deploy and restart, in words; the result is for ``--json``."""
    word = "would revoke" if run.dry_run else "revoked  "
    for each in result["revoked"]:
        yield f"{word} {each['subject']} serial {each['serial']}, generation {each['generation']}, {reason}"
    if peers := result["restart"]:
        yield (
            f"deploy and restart {quantity(len(peers), 'enclave')}: {subject_list(peers)}; a node that runs keeps its "
            "old list, and accepts the revoked certificate until its restart; existing connections continue until then"
        )
    if shared := result["shared"]:
        yield f"deploy {', '.join(shared)}, and restart what reads it"
    if again := result.get("issued_again"):
        yield f"deploy and restart with the new certificate: {subject_list(again)}"
    elif reason != SUPERSEDED and revoking.packages:
        barred = subject_list([*map(subject_of, revoking.packages)])
        yield f"nothing is issued for {barred} until 'keymint renew --rekey'"
