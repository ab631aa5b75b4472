# SPDX-License-Identifier: Apache-2.0
"""``keymint authority show``: each authority, where its key is, and whom it serves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import datetime
from itertools import chain
from typing import Any

from cryptography import x509

from comarmor.text import hexadecimal, quantity
from keymint.authority import authority_files
from keymint.authority.authorities import authority_named
from keymint.authority.authority_changes import uses
from keymint.command_line.verb import Report, Run, argument, verb
from keymint.examine.weaknesses import lacks
from keymint.life.renewal_schedule import authority_renewals, installed_terms
from keymint.life.revocation_lists_in_force import list_of
from keymint.life.terms import DEFAULT, days_left
from keymint.output.report import members
from keymint.pki import certificates, distinguished_names, extensions, keys
from keymint.workspace.session import Session


@verb(of="authority")
def authority_show(run: Run, names: tuple[str, ...] = argument(nargs=-1, metavar="[NAME]...")) -> Report:
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


def _documents(session: Session) -> Iterator[dict[str, Any]]:
    """Yield each authority as it is, in the order of the profile.

    Raises:
        KeymintError: a package has defects, or a revocation list is damaged.
    """
    used = uses(session)
    terms = installed_terms(session, session.packages()).values()
    due = authority_renewals(session, chain.from_iterable(terms))
    for authority in session.profile.authorities:
        files = authority_files.read_files(session, authority)
        spec, rollover = authority.certificate, authority.issuance.rollover
        revocations = list_of(session, authority.name)
        yield {
            "name": authority.name,
            "issuer": spec.issuer or None,
            "certificate": files.certificate and _certificate(files.certificate, due.get(authority.name)),
            "private_key": "token" if spec.key.uri else "here" if files.key is not None else "elsewhere",
            "imported": bool(spec.adopted),
            "serves": [asdict(use) for use in used[authority.name]],
            "revocation_list": revocations
            and {**members(revocations, "number", "next_update"), "revoked": len(revocations.revocations)},
            "replacement": rollover
            and {
                "phase": rollover.phase.value,
                "certificate": _certificate(certificates.load(rollover.certificate)),
            },
        }


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
        "serial": hexadecimal(certificate.serial_number),
        "key": f"RSA {kind.size}" if kind.algorithm == "rsa" else f"EC {kind.curve}",
        "fingerprint": keys.fingerprint(public),
        "not_before": first,
        "not_after": last,
        "renew_after": due or DEFAULT.moment(first, last),
        "key_usage": usages,
        "subject_key_identifier": identifier.digest.hex() if identifier else None,
    }


def _lines(authority: Mapping[str, Any], now: datetime) -> Iterator[str]:
    """Yield an authority in words."""
    yield authority["name"]
    if found := authority["certificate"]:
        first, last, renew = found["not_before"], found["not_after"], found["renew_after"]
        yield f"  subject       {found['subject']}"
        yield f"  key           {found['key']}, SHA-256 {found['fingerprint']}"
        left = f"({days_left(last, now)}), renew after {renew:%Y-%m-%d}"
        yield f"  valid         {first:%Y-%m-%d} to {last:%Y-%m-%d} {left}"
        yield f"  key usage     {'any' if found['key_usage'] is None else ', '.join(found['key_usage'])}"
    else:
        yield "  no certificate"
    yield f"  issued by     {authority['issuer'] or 'itself'}{' (imported)' if authority['imported'] else ''}"
    yield f"  private key   {authority['private_key']}"
    served = [
        f"{quantity(of['packages'], 'package')} ({of['role']}{', signs' if of['signs'] else ''}; {of['build_type']})"
        for of in authority["serves"]
    ]
    yield f"  serves        {'; '.join(served) or 'nobody'}"
    if found := authority["revocation_list"]:
        end = found["next_update"]
        yield f"  revocations   number {found['number']}, {found['revoked']} revoked, until {end:%Y-%m-%d}"
    if found := authority["replacement"]:
        yield f"  replacement   phase {found['phase']}; the other key is {found['certificate']['fingerprint']}"
