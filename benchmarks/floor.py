# SPDX-License-Identifier: Apache-2.0
"""The floor: the least work that provisions N enclaves, with bare ``cryptography`` calls.

A key, a certificate, one S/MIME signature and six files per enclave (with a governance document: two signatures and
seven files); no policy, no validation, no safe writing.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

_DAY = timedelta(days=1)


def builder_of(subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey) -> x509.CertificateBuilder:
    """Return the builder of a certificate that is valid for a year."""
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _DAY)
        .not_valid_after(now + 365 * _DAY)
    )


def authority(name: str) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return a self-signed authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = builder_of(subject, subject, key.public_key()).add_extension(
        x509.BasicConstraints(ca=True, path_length=None), critical=True
    )
    return builder.sign(key, hashes.SHA256()), key


def private_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key, PEM."""
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    return key.private_bytes(encoding, form, serialization.NoEncryption())


def provision(folder: Path, names: list[str], permissions: bytes, governance: bytes | None = None) -> None:
    """Write one enclave for each name into a folder.

    Args:
        folder: an empty folder.
        names: names of the enclaves.
        permissions: the unsigned permissions document, here the same for all.
        governance: the unsigned governance document; None for an enclave without one.
    """
    ca, ca_key = authority("identity_ca")
    notary, notary_key = authority("permissions_ca")
    ca_pem = ca.public_bytes(serialization.Encoding.PEM)
    notary_pem = notary.public_bytes(serialization.Encoding.PEM)
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    for name in names:
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        certificate = (
            builder_of(subject, ca.subject, key.public_key())
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False)
            .sign(ca_key, hashes.SHA256())
        )
        signed = {
            f"{kind}.p7s": pkcs7.PKCS7SignatureBuilder()
            .set_data(content)
            .add_signer(notary, notary_key, hashes.SHA256())
            .sign(serialization.Encoding.SMIME, options)
            for kind, content in (("permissions", permissions), ("governance", governance))
            if content is not None
        }
        files = signed | {
            "permissions.xml": permissions,
            "cert.pem": certificate.public_bytes(serialization.Encoding.PEM),
            "key.pem": private_bytes(key),
            "identity_ca.cert.pem": ca_pem,
            "permissions_ca.cert.pem": notary_pem,
        }
        enclave = folder / name
        enclave.mkdir(parents=True)
        for file, content in files.items():
            (enclave / file).write_bytes(content)
