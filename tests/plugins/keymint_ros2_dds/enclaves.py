# SPDX-License-Identifier: Apache-2.0
"""Enclaves made of real certificates, and inspections of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from keymint_ros2_dds import build_type

from keymint.api import (
    BuildOptions,
    CertificateSpec,
    Credentials,
    Inspection,
    KeySpec,
    Package,
    SigningAuthority,
    TrustAnchor,
    TrustAnchors,
    Validity,
)
from keymint.pki import certificates, keys

from .packages import ORIGIN, VALIDITY

NOW = datetime(2027, 1, 1, tzinfo=UTC)
EC = KeySpec("ec", "SECP256R1")
_LONG = Validity(VALIDITY.not_before - timedelta(days=2), VALIDITY.not_after + timedelta(days=3650))


@dataclass(frozen=True)
class Ca:
    name: str
    key: keys.PrivateKey
    certificate: certificates.x509.Certificate

    @property
    def pem(self) -> bytes:
        return certificates.to_pem(self.certificate)

    @property
    def signer(self) -> SigningAuthority:
        return SigningAuthority(self.name, self.pem, keys.to_pem(self.key))


@cache
def authority(name: str) -> Ca:
    key = keys.generate(EC)
    spec = CertificateSpec(f"CN={name}", _LONG, None, "", "SHA256", EC, (), ORIGIN)
    return Ca(name, key, certificates.issue(spec, key.public_key(), key, authority=True).certificate)


def credentials(package: Package, identity: str = "identity_ca", permissions: str = "permissions_ca") -> Credentials:
    key = keys.generate(EC)
    issuer = authority(identity)
    issued = certificates.issue(
        package.identity, key.public_key(), certificates.Issuer(issuer.certificate, issuer.key), authority=False
    )
    chains, signers = _chains(identity, permissions), {"permissions": authority(permissions).signer}
    return Credentials(chains, signers, issued.pem, keys.to_pem(key))


def _chains(identity: str, permissions: str) -> dict[str, bytes]:
    return {"identity": authority(identity).pem, "permissions": authority(permissions).pem}


def installed(package: Package, layout: str = "sros2", **authorities: str) -> dict[str, bytes]:
    """Return the files of an enclave by name."""
    documents = build_type.build(package, BuildOptions()).documents
    artifacts = build_type.install(package, documents, credentials(package, **authorities), layout, {})
    return {name: artifact.content for name, artifact in artifacts.items()}


def inspection(package: Package, files: dict[str, bytes], **fields) -> Inspection:
    usual = Inspection(
        [package],
        build_type.build(package, BuildOptions()).documents,
        files,
        f"install/enclaves/{package.name}",
        "sros2",
        _chains("identity_ca", "permissions_ca"),
        NOW,
        30,
    )
    return replace(usual, **fields)


def anchors(package: Package, layout: str = "sros2", **chains: bytes) -> TrustAnchors:
    """Return the authorities that the enclave of a package must rest on."""
    identity, permissions = (
        TrustAnchor(name, f"public/{name}.cert.pem", chains.get(name, authority(name).pem))
        for name in ("identity_ca", "permissions_ca")
    )
    return TrustAnchors({"identity": identity, "permissions": permissions}, package.identity.subject_name, layout)


def revoking(issuer: str, serial: int) -> bytes:
    """Return a revocation list of an authority with one certificate."""
    ca = authority(issuer)
    entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(NOW).build()
    made = x509.CertificateRevocationListBuilder().issuer_name(ca.certificate.subject)
    made = (
        made.last_update(NOW - timedelta(days=1)).next_update(NOW + timedelta(days=60)).add_revoked_certificate(entry)
    )
    return made.sign(ca.key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
