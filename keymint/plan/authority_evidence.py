# SPDX-License-Identifier: Apache-2.0
"""Evidence in the workspace that contradicts the certificate of an authority.

Proofs rest on the certificates in ``public/``. The workspace has other evidence of what these should be: the private
key beside each, the record of keys in use, and the profile. If that contradicts the certificate, or the file contains
more than one certificate, nothing that rests on it is claimed. Enclaves are no evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from comarmor.errors import Diagnostic
from keymint.errors import KeymintError
from keymint.pki import certificates
from keymint.plan import authority_files
from keymint.plan.authority_files import AuthorityFiles
from keymint.session import Inputs, Session, once

Contradictions = Mapping[str, tuple[Diagnostic, ...]]
"""Contradicting evidence by authority; contradictions of an issuer count for the authorities below it."""


@once
def contradictions(session: Session) -> Contradictions:
    """Return the contradictions of all authorities of a workspace that have any.

    A missing certificate is no contradiction.
    """
    by_authority: dict[str, tuple[Diagnostic, ...]] = {}
    for authority in authority_files.in_order(session.profile.authorities):
        files = authority_files.read_files(session, authority, deployed=False)
        own = () if files.content is None else tuple(_against(session, files, files.content))
        if all_ := (*own, *by_authority.get(authority.certificate.issuer, ())):
            by_authority[authority.name] = all_
    return by_authority


def contradictions_for(contradictions: Contradictions, issuers: Iterable[str]) -> tuple[Diagnostic, ...]:
    """Return the contradictions of some authorities, each once."""
    return tuple(dict.fromkeys(each for issuer in issuers for each in contradictions.get(issuer, ())))


def _against(inputs: Inputs, files: AuthorityFiles, content: bytes) -> Iterator[Diagnostic]:
    where = files.certificate_file
    try:
        # Transports differ in what they read of a file with several blocks: some trust each certificate in it.
        certificates.load(content, where)
        public = certificates.public_key(certificates.load_first(content, where), where)
        authority_files.require_name(files)
        _require_adopted(files, content)
        _require_key(inputs, files)
        authority_files.require_known(files, public)
    except KeymintError as error:
        yield from error.diagnostics


def _require_adopted(files: AuthorityFiles, content: bytes) -> None:
    """Require that the certificate is the one that the profile adopts, if it adopts one.

    Raises:
        KeymintError: it is not.
    """
    adopted = files.authority.certificate.adopted
    if adopted and content != adopted:
        raise KeymintError(
            f"is not the certificate that was imported for the authority {files.name!r}",
            where=files.certificate_file,
            help="'keymint install' restores it; 'keymint authority import' takes another one",
            code="authority-drift",
        )


def _require_key(inputs: Inputs, files: AuthorityFiles) -> None:
    """Require that the private key matches the certificate; a key that cannot be read is no evidence.

    Raises:
        KeymintError: it does not match.
    """
    if files.authority.certificate.key.uri:
        return
    try:
        stored = authority_files.stored_key(inputs, files.authority, files.name)
    except KeymintError:
        return
    if stored:
        authority_files.require_fit(files, stored[1].public_key())
