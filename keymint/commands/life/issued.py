# SPDX-License-Identifier: Apache-2.0
"""``keymint issued``: the register of issued certificates."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from functools import partial
from typing import Any

from comarmor.text import hexadecimal, natural_order
from keymint.command_line.options import Names, names_group
from keymint.command_line.verb import Report, Run, flag, verb
from keymint.errors import KeymintError
from keymint.life.register import IssuedCertificate
from keymint.life.workspace_register import complete_register, register_change
from keymint.names import subject_of
from keymint.output.report import members
from keymint.store.changes import Action, Plan, Step
from keymint.workspace.session import Session

STAGE = "register"


@verb(dry_run=True, name="issued", former={"tolerate": "--accept"})
def issued_certificates(
    run: Run, names: Names = names_group(), revoked: bool = flag(), tolerate: bool = flag()
) -> Report:
    """List the certificates that were issued: serial number, subject, generation, dates, and whether it is revoked.

    NAME is a package [all], also one whose sources are gone. --json has the fingerprints of the keys as well.

    Options:
        revoked: Only certificates that were revoked.
        tolerate: Accept that holders may still present documents of NAME that were signed before and permit more than
            the policy, until they expire: 'check', 'prove' and 'status' no longer report them.
    """
    if tolerate:
        return run.change(partial(_accepted, run, names))
    session = run.session()
    register = complete_register(session)
    known = {each.name for each in register.certificates.values() if each.name}
    hint = "without a name it lists all certificates"
    chosen = frozenset(names.packages(run, session, known.union(session.packages()), otherwise=hint))
    entries = [
        each
        for each in register.certificates.values()
        if (each.name in chosen or not names) and (each.revoked or not revoked)
    ]
    documents = [certificate_json(each) for each in entries]
    columns = {"SUBJECT": "subject", "GENERATION": "generation", "SERIAL": "serial", "ISSUED": "issued"}
    rows = [each | {"state": _state(each, session.now)} for each in documents]
    rows.sort(key=lambda each: natural_order(each["subject"] or ""))
    run.console.table(columns | {"NOT AFTER": "not_after", "STATE": "state"}, rows)
    if not rows:
        run.console.line("no certificates")
    return run.report({"certificates": documents}, workspace=session.workspace)


def certificate_json(each: IssuedCertificate) -> dict[str, Any]:
    """Return the entry of a certificate for ``--json``; serial numbers are hexadecimal."""
    return {
        "serial": hexadecimal(each.serial),
        "authority": each.authority,
        "subject": subject_of(each.name) if each.name else None,
        **members(each, "generation", "issued", "not_before", "not_after", "key", "rights", "revoked", "reason"),
    }


def _state(certificate: Mapping[str, Any], now: datetime) -> str:
    if revoked := certificate["revoked"]:
        return f"revoked {revoked:%Y-%m-%d} ({certificate['reason']})"
    return "expired" if certificate["not_after"] < now else "in force"


def _accepted(run: Run, names: Names, session: Session) -> Plan:
    """Plan that the documents of some packages that were signed before stay good with the owner's consent.

    Raises:
        KeymintError: no package is named, or no document of one is known.
    """
    register = complete_register(session)
    known = {each.name for each in register.rights}
    chosen = names.packages(run, session, known.union(session.packages()), known) if names else ()
    missing = [name for name in chosen if name not in known]
    if missing or not chosen:
        who = f"of {subject_of(missing[0])} is known" if missing else "is tolerated unless you name it"
        raise KeymintError(f"no document {who}", help="'keymint check' names the packages", code="package-unknown")
    writes = register_change(session, register.with_accepted(chosen, session.now))
    action = Action.UPDATED if writes else Action.UNCHANGED
    detail = "earlier documents are tolerated"
    steps = (Step(STAGE, name, action, writes if name == chosen[0] else (), detail) for name in chosen)
    return Plan(tuple(steps), session.state)
