# SPDX-License-Identifier: Apache-2.0
"""Authorities, and the enclaves and bundles that they make."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from comarmor.errors import Origin
from keymint.api import CertificateSpec, KeySpec, Validity
from keymint.pki import certificates, keys
from keymint.robots import bundle, certification_request
from keymint.robots.bundle import Manifest
from keymint.robots.robot_keystore import Pending, Present
from tests.conftest import NOW

AT = datetime.fromtimestamp(NOW, UTC)
FILE = Origin("talker.bundle")
_EC = KeySpec("ec", curve="SECP256R1")
DAY = timedelta(days=1)
NONCE = "0123456789abcdef" * 2


def spec(name: str, first: datetime = AT - DAY, last: datetime = AT + 900 * DAY) -> CertificateSpec:
    return CertificateSpec(name, Validity(first, last), None, "", "SHA256", _EC, (), Origin("test"))


@functools.cache
def authority(name: str = "ca") -> certificates.Issuer:
    key = ec.generate_private_key(ec.SECP256R1())
    return certificates.Issuer(
        certificates.issue(spec(f"CN={name}"), key.public_key(), key, authority=True).certificate, key
    )


@functools.cache
def robot_key(name: str) -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


@functools.cache
def revocations(issuer: certificates.Issuer, number: int, *serials: int, last: datetime = AT + 90 * DAY) -> bytes:
    builder = x509.CertificateRevocationListBuilder().issuer_name(issuer.certificate.subject)
    builder = builder.last_update(AT - DAY).next_update(last).add_extension(x509.CRLNumber(number), critical=False)
    for serial in serials:
        entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(AT - DAY).build()
        builder = builder.add_revoked_certificate(entry)
    return builder.sign(issuer.key, hashes.SHA256()).public_bytes(Encoding.PEM)


@functools.cache
def certified(name: str, key: ec.EllipticCurvePrivateKey, begin: datetime, issuer: certificates.Issuer) -> bytes:
    asked = spec(f"CN=/{name}", begin, AT + 300 * DAY)
    return certificates.issue(asked, key.public_key(), issuer, authority=False).pem


@dataclass(frozen=True)
class Made:
    """What an authority makes for an enclave; every part can be replaced."""

    name: str = "robot/talker"
    identity: certificates.Issuer = field(default_factory=authority)
    rights: certificates.Issuer = field(default_factory=lambda: authority("rights"))
    key: ec.EllipticCurvePrivateKey = field(default_factory=lambda: robot_key("talker"))
    generation: int = 0
    issue: int = 5
    number: int = 3
    revoked: tuple[int, ...] = ()
    nonce: str = ""
    with_key: bool = False
    begin: datetime = AT - DAY
    more: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def certificate(self) -> bytes:
        return certified(self.name, self.key, self.begin, self.identity)

    @functools.cached_property
    def files(self) -> dict[str, bytes]:
        return {
            "cert.pem": self.certificate,
            "identity_ca.cert.pem": certificates.to_pem(self.identity.certificate),
            "permissions_ca.cert.pem": certificates.to_pem(self.rights.certificate),
            "permissions.p7s": f"rights {self.generation}".encode(),
            **({"crl.pem": revocations(self.identity, self.number, *self.revoked)} if self.number else {}),
            **({"key.pem": keys.to_pem(self.key)} if self.with_key else {}),
            **self.more,
        }

    @functools.cached_property
    def manifest(self) -> Manifest:
        return Manifest(
            enclave=f"/{self.name}",
            folder="enclaves",
            key=keys.fingerprint(self.key),
            authority=keys.fingerprint(self.identity.key),
            generation=self.generation,
            issue=self.issue,
            revocations=self.number,
            nonce=self.nonce,
            not_before=self.begin,
            not_after=AT + 300 * DAY,
            files={},
        )

    @functools.cached_property
    def packed(self) -> bytes:
        return bundle.write(self.manifest, self.files, self.identity)

    @functools.cached_property
    def bundle(self) -> bundle.Bundle:
        return bundle.read(self.packed, FILE)

    def but(self, **parts: object) -> Made:
        return replace(self, **parts)

    def installed(self, **more: bytes) -> dict[str, bytes]:
        """Return the files of the enclave on the robot once the bundle was accepted."""
        return {**self.files, "key.pem": keys.to_pem(self.key), "bundle.json": self.bundle.encoded, **more}


def asked(made: Made, nonce: str = NONCE, *, key: bool = True) -> Pending:
    """Return the request of a robot that waits for what was made."""
    written = certification_request.make(f"/{made.name}", made.key, nonce)
    return Pending(certification_request.read(written, Origin("request")), keys.to_pem(made.key) if key else b"")


def keystore(
    files: Mapping[str, bytes] | None = None, pending: Pending | None = None, known: Made | None = None
) -> Present:
    """Return a keystore with an enclave, a request, and the authorities of another enclave."""
    trusted: dict[str, frozenset[str]] = {}
    issuing: frozenset[str] = frozenset()
    for each in (files or {}, known.files if known else {}):
        chains = bundle.certificates_of_authorities(each)
        issuing |= bundle.issuing_files(each.get("cert.pem", b""), chains)
        for name, chain in chains.items():
            trusted[name] = trusted.get(name, frozenset()) | {certificates.fingerprint(one) for one in chain}
    return Present("install/enclaves/robot/talker", files or {}, pending, trusted, issuing)
