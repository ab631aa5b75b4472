# SPDX-License-Identifier: Apache-2.0
"""Certificates for a cluster and its user."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID


def write_credentials(folder: Path) -> dict[str, str]:
    """Write an authority, and a certificate with its key for the cluster and the user.

    Returns:
        The environment variables by which the user names them.
    """
    authority = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "cluster")])
    _write(folder / "ca.pem", folder / "ca.key", name, authority, authority, name)
    for who in ("cluster", "user"):
        own = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, who + " of the cluster")])
        _write(
            folder / f"{who}.pem", folder / f"{who}.key", own, ec.generate_private_key(ec.SECP256R1()), authority, name
        )
    prefix = "DASK_DISTRIBUTED__COMM__TLS__"
    return {
        f"{prefix}CA_FILE": str(folder / "ca.pem"),
        f"{prefix}CLIENT__CERT": str(folder / "user.pem"),
        f"{prefix}CLIENT__KEY": str(folder / "user.key"),
    }


def _write(
    file: Path,
    key_file: Path,
    name: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    authority: ec.EllipticCurvePrivateKey,
    issuer: x509.Name,
) -> None:
    start = datetime.now(UTC) - timedelta(hours=1)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(start + timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=name == issuer, path_length=None), critical=True)
        .sign(authority, hashes.SHA256())
    )
    file.write_bytes(certificate.public_bytes(Encoding.PEM))
    key_file.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    key_file.chmod(0o600)
