# SPDX-License-Identifier: Apache-2.0
"""Evidence in the workspace that contradicts the certificate of an authority.

Proofs rest on the certificates in ``public/``. The workspace has other evidence of what these should be: the private
key beside each, the record of keys in use, and the profile. If that contradicts the certificate, or the file contains
more than one certificate, nothing that rests on it is claimed. Enclaves are no evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from comarmor.errors import Defects, Diagnostic
from keymint.errors import KeymintError
from keymint.pki import certificates
from keymint.pki.keys import PublicKey
from keymint.plan import authority_files
from keymint.plan.authority_files import AuthorityFiles
from keymint.plan.build import is_current
from keymint.plan.build_types import issuers_of
from keymint.session import Inputs, Session, once


@once
def contradictions(session: Session) -> Mapping[str, tuple[Diagnostic, ...]]:
    """Return the contradictions of all authorities of a workspace that have any.

    Those of an issuer count for the authorities below it. A missing certificate is no contradiction.
    """
    by_authority: dict[str, tuple[Diagnostic, ...]] = {}
    for authority in authority_files.in_order(session.profile.authorities):
        files = authority_files.read_files(session, authority, deployed=False)
        own = () if files.content is None else against(files, _key(session, files))
        if all_ := (*own, *by_authority.get(authority.certificate.issuer, ())):
            by_authority[authority.name] = all_
    return by_authority


def contradictions_for(session: Session, name: str) -> tuple[Diagnostic, ...]:
    """Return the contradictions of the authorities that the enclave of a package rests on, each once.

    Raises:
        KeymintError: the package has defects.
    """
    known = contradictions(session)
    issuers = issuers_of(session, session.package(name, built=is_current(session, name))) if known else ()
    return tuple(dict.fromkeys(each for issuer in issuers for each in known.get(issuer, ())))


def against(files: AuthorityFiles, key: PublicKey | None) -> tuple[Diagnostic, ...]:
    """Return what contradicts the certificate of an authority: its form, its key, its name, and what is recorded.

    Args:
        files: the files of the authority, of which the certificate is there.
        key: the public key of its private key; None if that is not known.
    """
    content, where, adopted = files.content or b"", files.certificate_file, files.authority.certificate.adopted
    defects = Defects()
    with defects:
        # Transports differ in what they read of a file with several blocks: some trust each certificate in it.
        certificates.load(content, where)
        public = certificates.public_key(certificates.load_first(content, where), where)
        if adopted and content != adopted:
            raise KeymintError(
                f"is not the certificate that was imported for the authority {files.name!r}",
                where=where,
                help="'keymint install' restores it; 'keymint authority import' takes another one",
                code="authority-drift",
            )
        authority_files.require_in_use(files, key or public)
    return tuple(defects.found)


def _key(inputs: Inputs, files: AuthorityFiles) -> PublicKey | None:
    """Return the public key of the stored private key of an authority; one that cannot be read is no evidence."""
    if not files.authority.certificate.key.uri:
        with suppress(KeymintError):
            stored = authority_files.stored_key(inputs, files.authority, files.name)
            return stored[1].public_key() if stored else None
    return None
