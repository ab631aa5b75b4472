# SPDX-License-Identifier: Apache-2.0
"""Check the authorities: keys and certificates that do not match, were replaced, or expire soon."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace
from datetime import timedelta

from cryptography import x509

from comarmor.errors import Defects, Diagnostic
from keymint.api import ValidityTerm
from keymint.authority import authority_files
from keymint.authority.authorities import key_copies
from keymint.authority.authority_files import AuthorityFiles
from keymint.errors import KeymintError
from keymint.life import terms
from keymint.pki import certificates, keys
from keymint.stages.proof.trust_anchors import certificate_contradictions
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import key_defects


def authorities(session: Session, within: timedelta) -> Iterator[Diagnostic]:
    """Yield the findings on the keys and certificates of all authorities."""
    issuers: dict[str, x509.Certificate] = {}
    fingerprints: dict[str, str] = {}
    for authority in authority_files.in_order(session.profile.authorities):
        files = authority_files.read_files(session, authority)
        key = yield from _key(session, files)
        if key is not None:
            fingerprints[authority.name] = keys.fingerprint(key)
        if files.content is None:
            yield Diagnostic.error(
                "authority-missing",
                f"the authority {authority.name!r} has no certificate",
                files.certificate_file,
                "'keymint install' restores it"
                if files.key or authority.certificate.key.uri
                else f"restore it; {authority_files.new_authority_help(authority.name)}",
            )
            continue
        yield from _certificate(files, key, issuers)
        if files.certificate is not None:
            issuers[authority.name] = files.certificate
            fingerprints.setdefault(authority.name, certificates.fingerprint(files.certificate))
            what, period = f"the certificate of {authority.name!r}", certificates.period(files.certificate)
            term = ValidityTerm("authority", what, files.certificate_file, (period,))
            for found in terms.findings([term], session.now, "", within):
                yield replace(found, help=found.help.replace("renew'", f"renew {authority.name}'"))
    with Defects() as defects:
        authority_files.require_own_keys(session, fingerprints)
    yield from defects.found


def in_defect(findings: tuple[Diagnostic, ...]) -> Diagnostic | None:
    """Return a finding that makes installing fail until a person decides, or None."""
    return next((finding for finding in findings if finding.code in _DECIDED_BY_A_PERSON), None)


_DECIDED_BY_A_PERSON = frozenset(
    {
        "authority-key-mismatch",
        "authority-key-shared",
        "authority-renamed",
        "authority-replaced",
        "key-invalid",
        "key-kind",
    }
)


def _key(inputs: Inputs, files: AuthorityFiles) -> Generator[Diagnostic, None, keys.PublicKey | None]:
    """Check the private key; the generator returns its public key if it can be read."""
    if files.authority.certificate.key.uri:
        yield from key_copies(files)
    elif files.key is not None:
        try:
            return authority_files.load_private_key(inputs, files).public_key()
        except KeymintError as error:
            yield from key_defects(error)
    return None


def _certificate(
    files: AuthorityFiles, key: keys.PublicKey | None, issuers: Mapping[str, x509.Certificate]
) -> Iterator[Diagnostic]:
    """Check a certificate against its key, the certificates in use, and the profile."""
    spec, certificate = files.authority.certificate, files.certificate
    defects = certificate_contradictions(files, key)
    if certificate is None:
        help_ = "'keymint install' restores it" if files.key else "restore it from a backup"
        defects = tuple(replace(defect, help=help_) for defect in defects)
    yield from defects
    if defects or certificate is None:
        return
    public, issuer = certificates.public_key(certificate), issuers.get(spec.issuer)
    if not authority_files.satisfies(files.content or b"", spec, public, issuer):
        yield Diagnostic.error(
            "authority-drift",
            f"the certificate of {files.name!r} is not the one that the profile specifies",
            files.certificate_file,
            "run 'keymint install', which reissues it for the same key, and redeploy all enclaves",
        )
