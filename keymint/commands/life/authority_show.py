# SPDX-License-Identifier: Apache-2.0
"""``keymint authority show``: each authority, where its key is, and whom it serves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import datetime
from itertools import chain
from typing import Any

import click
from cryptography import x509

from comarmor.text import counted
from keymint.authority import authority_files
from keymint.authority.authorities import authority_named
from keymint.authority.authority_changes import uses
from keymint.command_line.options import complete_authority
from keymint.command_line.verb import verb
from keymint.examine.weaknesses import lacks
from keymint.life.renewal_schedule import authority_renewals, installed_terms
from keymint.life.revocation_lists_in_force import list_of
from keymint.life.terms import DEFAULT, days_left
from keymint.output.report import Report
from keymint.pki import certificates, distinguished_names, extensions, keys
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
    shown = [each for each in _documents(session) if not names or each["name"] in names]
    for each in shown:
        run.console.lines(_lines(each, session.now))
    # What certificates lack.
    findings = [each for name, found in lacks(session).items() if not names or name in names for each in found]
    return run.report({"authorities": shown}, findings, workspace=session.workspace)


def _documents(session: Session) -> list[dict[str, Any]]:
    """Return each authority as it is, in the order of the profile.

    Raises:
        KeymintError: a package has defects, or a revocation list is damaged.
    """
    used = uses(session)
    terms = installed_terms(session, session.packages()).values()
    due = authority_renewals(session, chain.from_iterable(terms))
    documents = []
    for authority in session.profile.authorities:
        files = authority_files.read_files(session, authority)
        spec, rollover = authority.certificate, authority.issuance.rollover
        revocations = list_of(session, authority.name)
        document = {
            "name": authority.name,
            "issuer": spec.issuer or None,
            "certificate": files.certificate and _certificate(files.certificate, due.get(authority.name)),
            "private_key": "token" if spec.key.uri else "here" if files.key is not None else "elsewhere",
            "imported": bool(spec.adopted),
            "serves": [asdict(use) for use in used[authority.name]],
            "revocation_list": revocations
            and {
                "number": revocations.number,
                "next_update": revocations.next_update,
                "revoked": len(revocations.revocations),
            },
            "replacement": rollover
            and {
                "phase": rollover.phase.value,
                "certificate": _certificate(certificates.load(rollover.certificate)),
            },
        }
        documents.append(document)
    return documents


def _certificate(certificate: x509.Certificate, due: datetime | None = None) -> dict[str, Any]:
    """Return a certificate of an authority as data.

    Args:
        certificate: the certificate.
        due: when it begins to shorten what it signs, as 'keymint renew' reports it, UTC; None if that is not known, as
            if it signed nothing that is installed: then when two thirds of its validity are over.
    """
    public = certificates.public_key(certificate)
    kind = keys.kind_of(public)
    first, last = certificates.period(certificate)
    usages = extensions.usages(certificate)
    identifier = extensions.value(certificate, x509.SubjectKeyIdentifier)
    return {
        "subject": distinguished_names.to_text(certificate.subject),
        "serial": f"{certificate.serial_number:x}",
        "key": f"RSA {kind.size}" if kind.algorithm == "rsa" else f"EC {kind.curve}",
        "fingerprint": keys.fingerprint(public),
        "not_before": first,
        "not_after": last,
        "renew_after": due or DEFAULT.moment(first, last),
        "key_usage": usages,
        "subject_key_identifier": identifier.digest.hex() if identifier else None,
    }


def _lines(each: Mapping[str, Any], now: datetime) -> Iterator[str]:
    yield each["name"]
    if each["certificate"] is None:
        yield "  no certificate"
    else:
        for label, text in _of_certificate(each["certificate"], now):
            yield f"  {label:13} {text}"
    yield f"  {'issued by':13} {each['issuer'] or 'itself'}{' (imported)' if each['imported'] else ''}"
    yield f"  {'private key':13} {each['private_key']}"
    served = [
        f"{counted(use['packages'], 'package')} ({use['role']}{', signs' if use['signs'] else ''}; {use['build_type']})"
        for use in each["serves"]
    ]
    yield f"  {'serves':13} {'; '.join(served) or 'nobody'}"
    if of_list := each["revocation_list"]:
        text = f"number {of_list['number']}, {of_list['revoked']} revoked, until {of_list['next_update']:%Y-%m-%d}"
        yield f"  {'revocations':13} {text}"
    if replaced := each["replacement"]:
        other = replaced["certificate"]["fingerprint"]
        yield f"  {'replacement':13} phase {replaced['phase']}; the other key is {other}"


def _of_certificate(found: Mapping[str, Any], now: datetime) -> Iterator[tuple[str, str]]:
    first, last, renew = found["not_before"], found["not_after"], found["renew_after"]
    yield "subject", found["subject"]
    yield "key", f"{found['key']}, SHA-256 {found['fingerprint']}"
    yield "valid", f"{first:%Y-%m-%d} to {last:%Y-%m-%d} ({days_left(last, now)}), renew after {renew:%Y-%m-%d}"
    yield "key usage", "any" if found["key_usage"] is None else ", ".join(found["key_usage"])
