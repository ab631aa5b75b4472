# SPDX-License-Identifier: Apache-2.0
"""Enclaves written with ``cryptography`` alone, to test vendors on documents that Keymint does not write."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7
from cryptography.x509.oid import ExtendedKeyUsageOID
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class Authority:
    """A self-signed P-256 authority."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey = field(repr=False)

    @classmethod
    def new(cls, name: str, key: ec.EllipticCurvePrivateKey | None = None) -> Authority:
        """Create an authority with a common name, and with a new key if none is given."""
        key = key or ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name.from_rfc4514_string(f"CN={name}")
        usage = _key_usage(digital_signature=True, key_cert_sign=True, crl_sign=True)
        identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
        builder = _builder(subject, subject, key.public_key())
        builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        builder = builder.add_extension(usage, critical=True).add_extension(identifier, critical=False)
        return cls(builder.sign(key, hashes.SHA256()), key)

    def issue(
        self,
        rdns: Sequence[tuple[x509.ObjectIdentifier, str]],
        usages: Sequence[x509.ObjectIdentifier] = (ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH),
        hosts: Sequence[x509.GeneralName] = (),
    ) -> tuple[x509.Certificate, bytes]:
        """Issue an identity with these RDNs in this order; return its certificate and its key as PEM.

        Args:
            rdns: its subject.
            usages: its extended key usages; none for a certificate without this extension.
            hosts: its alternative names; none for a certificate without this extension.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(oid, value) for oid, value in rdns])
        builder = _builder(subject, self.certificate.subject, key.public_key())
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(_key_usage(digital_signature=True), critical=True)
        if usages:
            builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        if hosts:
            builder = builder.add_extension(x509.SubjectAlternativeName(hosts), critical=False)
        pem = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        return builder.sign(self.key, hashes.SHA256()), pem

    def sign(self, document: str) -> bytes:
        """Sign a document as DDS Security requires: S/MIME multipart, with the text header (1.1, 9.4.1.1)."""
        builder = pkcs7.PKCS7SignatureBuilder().set_data(document.encode())
        builder = builder.add_signer(self.certificate, self.key, hashes.SHA256())
        options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        return builder.sign(serialization.Encoding.SMIME, options)

    @property
    def pem(self) -> bytes:
        """The authority's certificate as PEM."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)


@dataclass(frozen=True, slots=True)
class Authorities:
    """The two authorities of a system."""

    identity: Authority
    permissions: Authority
    issued: dict[str, bytes] = field(default_factory=dict, repr=False)

    @classmethod
    def new(cls) -> Authorities:
        """Create two separate authorities."""
        return cls(Authority.new("identity authority"), Authority.new("permissions authority"))

    def certificate_of(self, name: str) -> bytes:
        """Return the identity certificate for a common name as PEM, always the same one for a name."""
        if name not in self.issued:
            certificate, _ = self.identity.issue([(x509.NameOID.COMMON_NAME, name)])
            self.issued[name] = certificate.public_bytes(serialization.Encoding.PEM)
        return self.issued[name]

    def enclave(
        self,
        folder: Path,
        rules: str = "",
        *,
        name: str = "/talker",
        subject: str = "",
        rdns: Sequence[tuple[x509.ObjectIdentifier, str]] = (),
        governance: str = "",
        permissions: str = "",
    ) -> Path:
        """Write a complete enclave and return its folder.

        Args:
            folder: where; made if it is missing.
            rules: the rules of the grant, as XML.
            name: common name of the identity.
            subject: subject name of the grant, if it is not ``CN=`` and the name.
            rdns: the identity's subject, if it is not the common name alone.
            governance: the governance document, if it is not the default one.
            permissions: the permissions document, if it is not one with those rules.
        """
        certificate, key = self.identity.issue(rdns or [(x509.NameOID.COMMON_NAME, name)])
        folder.mkdir(parents=True, exist_ok=True)
        contents = {
            "identity_ca.cert.pem": self.identity.pem,
            "permissions_ca.cert.pem": self.permissions.pem,
            "cert.pem": certificate.public_bytes(serialization.Encoding.PEM),
            "key.pem": key,
            "governance.p7s": self.permissions.sign(governance or governance_document()),
            "permissions.p7s": self.permissions.sign(
                permissions or permissions_document(subject or f"CN={name}", rules)
            ),
        }
        for file, content in contents.items():
            (folder / file).write_bytes(content)
        return folder


def rule(effect: str, body: str, *, domain: int = 0) -> str:
    """Return an ``allow_rule`` or ``deny_rule`` with a body, e.g. from :func:`criteria`."""
    return f"<{effect}_rule><domains><id>{domain}</id></domains>{body}</{effect}_rule>"


def criteria(kind: str, topics: Sequence[str], partitions: Sequence[str] | None = None) -> str:
    """Return a ``publish``, ``subscribe`` or ``relay`` element; without ``<partitions>`` if they are None."""
    listed = "".join(f"<topic>{escape(topic)}</topic>" for topic in topics)
    narrowed = ""
    if partitions is not None:
        inner = "".join(f"<partition>{escape(partition)}</partition>" for partition in partitions)
        narrowed = f"<partitions>{inner}</partitions>"
    return f"<{kind}><topics>{listed}</topics>{narrowed}</{kind}>"


def permissions_document(subject: str, rules: str, *, default: str = "DENY") -> str:
    """Return an unsigned permissions document with one grant that began yesterday and lasts ten days."""
    now = datetime.now(UTC)
    begin, end = (f"{now + timedelta(days=days):%Y-%m-%dT%H:%M:%S}" for days in (-1, 10))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<dds><permissions><grant name="grant">'
        f"<subject_name>{escape(subject)}</subject_name>"
        f"<validity><not_before>{begin}</not_before><not_after>{end}</not_after></validity>"
        f"{rules}<default>{default}</default></grant></permissions></dds>\n"
    )


def governance_document(*, domains: str = "<id>0</id>", protection: str = "ENCRYPT") -> str:
    """Return an unsigned governance document that protects every topic completely."""
    topic = (
        "<topic_rule><topic_expression>*</topic_expression>"
        "<enable_discovery_protection>true</enable_discovery_protection>"
        "<enable_liveliness_protection>true</enable_liveliness_protection>"
        "<enable_read_access_control>true</enable_read_access_control>"
        "<enable_write_access_control>true</enable_write_access_control>"
        f"<metadata_protection_kind>{protection}</metadata_protection_kind>"
        f"<data_protection_kind>{protection}</data_protection_kind></topic_rule>"
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<dds><domain_access_rules><domain_rule>'
        f"<domains>{domains}</domains>"
        "<allow_unauthenticated_participants>false</allow_unauthenticated_participants>"
        "<enable_join_access_control>true</enable_join_access_control>"
        f"<discovery_protection_kind>{protection}</discovery_protection_kind>"
        f"<liveliness_protection_kind>{protection}</liveliness_protection_kind>"
        f"<rtps_protection_kind>{protection}</rtps_protection_kind>"
        f"<topic_access_rules>{topic}</topic_access_rules>"
        "</domain_rule></domain_access_rules></dds>\n"
    )


def _builder(subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key)
    builder = builder.serial_number(x509.random_serial_number())
    return builder.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=10))


def _key_usage(**granted: bool) -> x509.KeyUsage:
    names = (
        "digital_signature",
        "content_commitment",
        "key_encipherment",
        "data_encipherment",
        "key_agreement",
        "key_cert_sign",
        "crl_sign",
        "encipher_only",
        "decipher_only",
    )
    return x509.KeyUsage(**{name: granted.get(name, False) for name in names})


@contextmanager
def access_control(
    certificate: bytes, permissions_ca: bytes, governance: bytes, permissions: bytes, domain: int = 0
) -> Iterator[CycloneAccessControl]:
    """Open signed documents with the access-control plugin of Cyclone DDS."""
    contents = {
        "cert.pem": certificate, "permissions_ca.cert.pem": permissions_ca, "governance.p7s": governance,
        "permissions.p7s": permissions,
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        for name, content in contents.items():
            Path(folder, name).write_bytes(content)
        with CycloneAccessControl(Path(folder), domain) as opened:
            yield opened
