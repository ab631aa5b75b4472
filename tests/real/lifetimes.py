# SPDX-License-Identifier: Apache-2.0
"""Certificates and revocation lists of any dates and serials, to see what vendors do over the life of a keystore."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from .handmade import Authority, criteria, permissions_document, rule

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .handmade import Authorities

DAY = timedelta(days=1)
EVERYTHING = rule("allow", criteria("publish", ["*"]) + criteria("subscribe", ["*"]))


@dataclass(frozen=True, slots=True)
class Identity:
    """A certificate with its key, and the name that grants have for it."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey = field(repr=False)

    @property
    def pem(self) -> bytes:
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        forms = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        return self.key.private_bytes(serialization.Encoding.PEM, *forms)

    @property
    def name(self) -> str:
        return self.certificate.subject.rfc4514_string()


def identity(
    ca: Authority,
    name: str,
    unit: str = "0",
    *,
    begin: timedelta = -DAY,
    end: timedelta = DAY,
    key: ec.EllipticCurvePrivateKey | None = None,
) -> Identity:
    """Issue a certificate.

    Args:
        ca: its issuer.
        name: its CN.
        unit: its OU.
        begin: begin of its validity, from now.
        end: end of its validity, from now.
        key: its key, else a new one.
    """
    now, key = datetime.now(UTC), key or ec.generate_private_key(ec.SECP256R1())
    rdns = [x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, unit), x509.NameAttribute(NameOID.COMMON_NAME, name)]
    issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.key.public_key())
    builder = x509.CertificateBuilder().subject_name(x509.Name(rdns)).issuer_name(ca.certificate.subject)
    builder = builder.public_key(key.public_key()).serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(now + begin).not_valid_after(now + end)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    return Identity(builder.add_extension(issuer, critical=False).sign(ca.key, hashes.SHA256()), key)


def revocation_list(
    ca: Authority, revoked: Sequence[Identity] = (), *, begin: timedelta = -DAY, end: timedelta = DAY
) -> bytes:
    """Issue a revocation list, PEM; its dates are from now."""
    now = datetime.now(UTC)
    builder = x509.CertificateRevocationListBuilder().issuer_name(ca.certificate.subject)
    builder = builder.last_update(now + begin).next_update(now + end)
    identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.key.public_key())
    builder = builder.add_extension(identifier, critical=False)
    for each in revoked:
        entry = x509.RevokedCertificateBuilder().serial_number(each.certificate.serial_number)
        builder = builder.add_revoked_certificate(entry.revocation_date(now - DAY).build())
    return builder.sign(ca.key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def enclave(
    authorities: Authorities,
    folder: Path,
    who: Identity,
    *,
    trusted: bytes = b"",
    crl: bytes | None = None,
    end: timedelta | None = None,
) -> Path:
    """Write the enclave of an identity that may do everything; return its folder.

    Args:
        authorities: the authorities.
        folder: where; replaced if it is there.
        who: the identity.
        trusted: the file of the identity authority, if it is not the certificate of that of ``authorities``.
        crl: the revocation list, if there is one.
        end: end of the grant, from now; else in ten days.
    """
    document = permissions_document(who.name, EVERYTHING)
    if end is not None:
        last = f"<not_after>{datetime.now(UTC) + end:%Y-%m-%dT%H:%M:%S}</not_after>"
        document = re.sub("<not_after>.*</not_after>", last, document)
    authorities.enclave(folder, permissions=document)
    contents = {"cert.pem": who.pem, "key.pem": who.key_pem}
    if trusted:
        contents["identity_ca.cert.pem"] = trusted
    if crl is not None:
        contents["crl.pem"] = crl
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return folder
