# SPDX-License-Identifier: Apache-2.0
"""``keymint authority show``: each authority, where its key is, and whom it serves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from datetime import datetime
from typing import Any

import click

from comarmor.errors import Diagnostic
from comarmor.text import counted
from keymint.authority.authorities import authority_named
from keymint.command_line.options import complete_authority
from keymint.command_line.verb import verb
from keymint.examine.weaknesses import lacks
from keymint.life.authority_status import AuthorityStatus, CertificateStatus, statuses
from keymint.life.terms import days_left
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.workspace.session import Session


@verb(of="authority")
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_authority)
def command(run: Run, names: tuple[str, ...]) -> Report:
    """Show each authority: its certificate, where its key is, whom it serves, and how far its replacement has come.

    NAME is an authority of the profile [all].
    """
    session = run.session()
    for name in names:
        authority_named(session, name)
    shown = [each for each in statuses(session) if not names or each.authority.name in names]
    for each in shown:
        run.console.lines(_lines(each, session.now))
    result = {"authorities": [_document(each) for each in shown]}
    return run.report(result, _findings(session, names), workspace=session.workspace)


def _findings(session: Session, names: tuple[str, ...]) -> list[Diagnostic]:
    """Return the warnings about what certificates lack."""
    return [each for name, found in lacks(session).items() if not names or name in names for each in found]


def _lines(each: AuthorityStatus, now: datetime) -> Iterator[str]:
    authority = each.authority
    yield authority.name
    if each.certificate is None:
        yield "  no certificate"
    else:
        for label, text in _of_certificate(each.certificate, now):
            yield f"  {label:13} {text}"
    issuer = authority.certificate.issuer or "itself"
    yield f"  {'issued by':13} {issuer}{' (imported)' if authority.certificate.adopted else ''}"
    yield f"  {'private key':13} {each.key_place}"
    served = [
        f"{counted(use.packages, 'package')} ({use.role}{', signs' if use.signs else ''}; {use.build_type})"
        for use in each.uses
    ]
    yield f"  {'serves':13} {'; '.join(served) or 'nobody'}"
    if each.revocations is not None:
        of_list = each.revocations
        text = f"number {of_list.number}, {len(of_list.revocations)} revoked, until {of_list.next_update:%Y-%m-%d}"
        yield f"  {'revocations':13} {text}"
    rollover = authority.issuance.rollover
    if rollover and each.other:
        yield f"  {'replacement':13} phase {rollover.phase}; the other key is {each.other.fingerprint}"


def _of_certificate(status: CertificateStatus, now: datetime) -> Iterator[tuple[str, str]]:
    first, last, renew = status.not_before, status.not_after, status.renew_after
    yield "subject", status.subject
    yield "key", f"{status.key}, SHA-256 {status.fingerprint}"
    yield "valid", f"{first:%Y-%m-%d} to {last:%Y-%m-%d} ({days_left(last, now)}), renew after {renew:%Y-%m-%d}"
    yield "key usage", "any" if status.key_usage is None else ", ".join(status.key_usage)


def _document(each: AuthorityStatus) -> dict[str, Any]:
    spec, rollover = each.authority.certificate, each.authority.issuance.rollover
    other = each.other and asdict(each.other)
    return {
        "name": each.authority.name,
        "issuer": spec.issuer or None,
        "certificate": each.certificate and asdict(each.certificate),
        "private_key": each.key_place,
        "imported": bool(spec.adopted),
        "serves": [asdict(use) for use in each.uses],
        "revocation_list": None
        if each.revocations is None
        else {
            "number": each.revocations.number,
            "next_update": each.revocations.next_update,
            "revoked": len(each.revocations.revocations),
        },
        "replacement": {"phase": rollover.phase.value, "certificate": other} if rollover else None,
    }
