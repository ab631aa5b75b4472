# SPDX-License-Identifier: Apache-2.0
"""The certificate of an authority that somebody else issued, and perhaps its private key: checked before use."""

from __future__ import annotations

from dataclasses import field

from cryptography import x509

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import Authority
from keymint.authority import authority_files, token_authorities
from keymint.errors import KeymintError
from keymint.pki import certificates, distinguished_names, foreign_authorities, keys
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import password


@dataclass(frozen=True, slots=True)
class GivenAuthority:
    """Files that the user names.

    Attributes:
        certificate: a file with a certificate.
        where: this file, for messages.
        key: a file with its private key, encrypted with the authority's password or not; empty if none is given.
        key_file: this file, for messages; None if none is given.
        exposed: others could read the private key.
    """

    certificate: bytes
    where: Origin
    key: bytes = field(default=b"", repr=False)
    key_file: Origin | None = None
    exposed: bool = False


def cert_and_key(session: Session, authority: Authority, given: GivenAuthority) -> tuple[x509.Certificate, bytes]:
    """Return the certificate, and the private key as it is to be stored: PEM, or empty if none is given.

    Args:
        session: the workspace and its profile.
        authority: the authority whose certificate it is to be.
        given: the files.

    Raises:
        KeymintError: the certificate is not that of an authority, or not issued by its issuer in the profile; the key
            is another one, or is to lie in a token.
    """
    certificate = foreign_authorities.require_authority(given.certificate, given.where)
    _require_issuer(session, authority.certificate.issuer, certificate, given.where)
    if not given.key:
        return certificate, b""
    spec = authority.certificate
    if spec.key.uri:
        raise token_authorities.only_in_token(authority, "import it with the token's own tool")
    secret = password(session, spec)
    private = keys.from_pem(given.key, secret, given.key_file)
    of, help_ = str(given.where), "name the files that belong together"
    authority_files.require_pair(private, certificate, given.key_file, of, help_)
    return certificate, keys.to_pem(private, secret)


def _require_issuer(session: Session, issuer: str, certificate: x509.Certificate, where: Origin) -> None:
    """Require that a certificate was issued by the authority above it in the profile, or by itself.

    Raises:
        KeymintError: it was not: enclaves need all authorities up to a self-signed one.
    """
    above = authority_files.stored_certificate(session, issuer) if issuer else certificate
    if not certificates.is_issued_by(certificate, above):
        expected = f"the authority {issuer!r}" if issuer else "itself"
        raise KeymintError(
            f"was issued by {distinguished_names.to_text(certificate.issuer)!r}, but the profile expects {expected}",
            where=where,
            help="add its issuer to authorities.xml and name it in <issuer_name>; then import the issuer first",
            code="authority-issuer-elsewhere",
        )
