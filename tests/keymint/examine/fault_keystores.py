# SPDX-License-Identifier: Apache-2.0
"""Workspaces for fault injection, and what somebody with the keys of the authorities can write into them.

Documents, certificates and lists are made with ``cryptography`` and ``lxml`` alone, and signed with the workspace's own
keys: what a fault writes is what its writer meant, whatever Keymint thinks of it.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID
from lxml import etree

from tests.signers import by_sros2

Run = Callable[..., int]
"""Runs the command line; returns its exit code."""

DAY = timedelta(days=1)
TALKER, LISTENER, ROBOT, CAMERA, PLANNER = "/talker", "/robot1/listener", "/robot1", "/robot1/camera", "/planner"
SUBJECTS = (TALKER, LISTENER, ROBOT, CAMERA, PLANNER)
ADOPTED = (TALKER, "/listener", "/camera", PLANNER)
"""The subjects of the workspace that was adopted."""
PLAIN = (TALKER, LISTENER, "/arm", CAMERA, PLANNER)
"""The subjects of the workspace with plain names."""
NAMES = ("rt/chatter", "rt/chatterx", "rt/chatte", "rt/status/ok", "rt/status/secret", "rt/status/secretx", "rt/image",
         "rt/image2", "rt/imag", "rt/tf", "rt/tfx", "rt/t", "rt/cmd", "rt/cmd2", "rq/addRequest", "rr/addReply",
         "rt/zz1", "rt/zz", "x", "rt/status", "rt/new", "ros_discovery_info", "rt/new2", "rt/chattez",
         "rt/status/okx", "rt/status/oz", "rt/status/o", "rt/imagz", "rt/tz", "rt/cmz", "rq/addRequestx",
         "rq/addRequesz", "rq/addReques", "rr/addReplyx", "rr/addReplz", "rr/addRepl", "rt/statux", "rt/statusx",
         "rt/statu", "rr/planner/x", "rq/addRequest2", "rq/addxRequest", "rr/addxReply")  # fmt: skip
"""Names of topics that documents are asked about; each pattern of a fault matches one that it changes."""


@dataclass(frozen=True)
class Issuer:
    """A certificate with its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


@dataclass(frozen=True)
class Keystore:
    """A provisioned workspace that a fault changes.

    Attributes:
        ws: the workspace. Beside it are the policy, and ``stages/N/``: install spaces of earlier days.
        now: the time.
        run: runs the command line at that time.
    """

    ws: Path
    now: datetime
    run: Run

    def do(self, *words: object) -> None:
        """Run a verb in the workspace."""
        assert self.run(*words, "-w", self.ws, "-q") == 0, words

    def enclave(self, subject: str, space: str = "install") -> Path:
        return self.ws / space / "enclaves" / subject[1:]

    def stage(self, number: int, subject: str) -> Path:
        return self.ws.parent / "stages" / str(number) / "enclaves" / subject[1:]

    def certificate(self, subject: str, space: str = "install") -> x509.Certificate:
        return x509.load_pem_x509_certificate((self.enclave(subject, space) / "cert.pem").read_bytes())

    def name(self, subject: str, space: str = "install") -> str:
        """The subject name of the grant that an enclave has."""
        return str(self.permissions(subject, space).findtext(".//subject_name"))

    def issuer(self, role: str, subject: str, space: str = "install") -> Issuer:
        """Return the authority that an enclave trusts for a role, with its private key out of ``private/``."""
        certificate = x509.load_pem_x509_certificates((self.enclave(subject, space) / f"{role}.cert.pem").read_bytes())
        return self.with_key(certificate[0])

    def with_key(self, certificate: x509.Certificate) -> Issuer:
        """Find the private key of a certificate."""
        places = [*(self.ws / "private").rglob("*key.pem"), *self.ws.glob("install*/enclaves/**/key.pem")]
        for path in sorted(places):
            key = load_pem_private_key(path.read_bytes(), None)
            if public(key.public_key()) == public(certificate.public_key()):
                assert isinstance(key, ec.EllipticCurvePrivateKey)
                return Issuer(certificate, key)
        raise AssertionError(certificate.subject)

    def permissions(self, subject: str, space: str = "install") -> etree._Element:
        return parsed((self.enclave(subject, space) / "permissions.xml").read_bytes())

    def governance(self, space: str = "install") -> etree._Element:
        return parsed((self.ws / space / "enclaves/governance.xml").read_bytes())

    def sign_permissions(
        self, subject: str, document: etree._Element, space: str = "install", signer: Issuer | None = None
    ) -> None:
        """Replace the permissions of an enclave, plain and signed, by default by the authority that it trusts."""
        content = written(document)
        folder = self.enclave(subject, space)
        (folder / "permissions.xml").write_bytes(content)
        signer = signer or self.issuer("permissions_ca", subject, space)
        put(folder / "permissions.p7s", by_sros2(content, signer.certificate, signer.key))

    def sign_governance(
        self, subjects: Iterable[str], document: etree._Element, space: str = "install", signer: Issuer | None = None
    ) -> None:
        """Replace the governance of enclaves; of all of them also the common file."""
        content, subjects = written(document), tuple(subjects)
        for subject in subjects:
            own = signer or self.issuer("permissions_ca", subject, space)
            signed = by_sros2(content, own.certificate, own.key)
            put(self.enclave(subject, space) / "governance.p7s", signed)
        if len(subjects) > 1:
            (self.ws / space / "enclaves/governance.xml").write_bytes(content)
            (self.ws / space / "enclaves/governance.p7s").write_bytes(signed)

    def issue(
        self,
        subject: str,
        *,
        space: str = "install",
        issuer: Issuer | None = None,
        key: ec.EllipticCurvePublicKey | None = None,
        begin: timedelta = -DAY,
        end: timedelta = 300 * DAY,
        name: x509.Name | None = None,
    ) -> bytes:
        """Return a certificate like that of an enclave, by its identity authority, that no register knows."""
        own, issuer = self.certificate(subject, space), issuer or self.issuer("identity_ca", subject, space)
        builder = x509.CertificateBuilder().subject_name(name or own.subject).issuer_name(issuer.certificate.subject)
        builder = builder.public_key(key or own.public_key()).serial_number(x509.random_serial_number())  # type: ignore[arg-type]
        builder = builder.not_valid_before(self.now + begin).not_valid_after(self.now + end)
        for extension in own.extensions:
            if not isinstance(extension.value, x509.SubjectKeyIdentifier | x509.AuthorityKeyIdentifier):
                builder = builder.add_extension(extension.value, extension.critical)
        identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.key.public_key())
        builder = builder.add_extension(identifier, critical=False)
        return builder.sign(issuer.key, hashes.SHA256()).public_bytes(Encoding.PEM)

    def revocation_list(
        self,
        serials: Iterable[int],
        *,
        subject: str = TALKER,
        number: int = 99,
        begin: timedelta = -DAY,
        end: timedelta = 900 * DAY,
        issuer: Issuer | None = None,
    ) -> bytes:
        """Return a list by the identity authority that an enclave trusts."""
        issuer = issuer or self.issuer("identity_ca", subject)
        builder = x509.CertificateRevocationListBuilder().issuer_name(issuer.certificate.subject)
        builder = builder.last_update(self.now + begin).next_update(self.now + end)
        for serial in sorted(serials):
            revoked = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(self.now + begin)
            builder = builder.add_revoked_certificate(revoked.build())
        builder = builder.add_extension(x509.CRLNumber(number), critical=False)
        identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.key.public_key())
        builder = builder.add_extension(identifier, critical=False)
        return builder.sign(issuer.key, hashes.SHA256()).public_bytes(Encoding.PEM)


def public(key: object) -> bytes:
    return key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)  # type: ignore[attr-defined,no-any-return]


def private_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def put(path: Path, content: bytes) -> None:
    """Write a file in the place of a file or of a link."""
    path.unlink(missing_ok=True)
    path.write_bytes(content)


def parsed(content: bytes) -> etree._Element:
    return etree.fromstring(content, etree.XMLParser(remove_blank_text=True))


def written(root: etree._Element) -> bytes:
    """Return a document with fresh indentation."""
    copy = parsed(etree.tostring(root))
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + etree.tostring(copy, pretty_print=True)


def stranger(name: str) -> Issuer:
    """Return a self-signed authority that nobody knows, with a common name."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(subject).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(datetime(2020, 1, 1, tzinfo=UTC))
    builder = builder.not_valid_after(datetime(2045, 1, 1, tzinfo=UTC))
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    usage = x509.KeyUsage(True, False, False, False, False, True, True, False, False)
    builder = builder.add_extension(usage, critical=True)
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    builder = builder.add_extension(identifier, critical=False)
    return Issuer(builder.sign(key, hashes.SHA256()), key)


SERVER_AND_CLIENT = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])

# -- what documents mean ---------------------------------------------------------------------------------------------

Decision = tuple[int, str, str]
"""A domain, ``publish`` or ``subscribe``, and a topic."""


def allowed(grant: etree._Element, domains: Sequence[int] = (0, 1, 5), names: Sequence[str] = NAMES) -> set[Decision]:
    """Return what a grant allows in the empty partition: the first rule that applies decides (DDS Security 9.4.1.3)."""
    return {
        (domain, action, name)
        for domain in domains
        for action in ("publish", "subscribe")
        for name in names
        if _effect(grant, domain, action, name)
    }


def _effect(grant: etree._Element, domain: int, action: str, name: str) -> bool:
    for rule in grant.iterfind("*"):
        if rule.tag in {"allow_rule", "deny_rule"} and _covers(rule.find("domains"), domain):
            for criteria in rule.iterfind(action):
                found = any(fnmatch.fnmatchcase(name, topic.text or "") for topic in criteria.iterfind("topics/topic"))
                partitions = [each.text or "" for each in criteria.iterfind("partitions/partition")] or [""]
                if found and (rule.tag == "deny_rule" or any(fnmatch.fnmatchcase("", each) for each in partitions)):
                    return bool(rule.tag == "allow_rule")
    return bool(grant.findtext("default") == "ALLOW")


def _covers(domains: etree._Element | None, domain: int) -> bool:
    assert domains is not None
    ranges = [(int(str(each.text)),) * 2 for each in domains.iterfind("id")]
    ranges += [
        (int(each.findtext("min") or 0), int(each.findtext("max") or 0)) for each in domains.iterfind("id_range")
    ]
    return any(first <= domain <= last for first, last in ranges)


def meaning(keystore: Keystore, subjects: Iterable[str] = SUBJECTS, space: str = "install") -> dict[str, set[Decision]]:
    """Return what the first grant of each enclave allows."""
    found = {}
    for subject in subjects:
        grant = keystore.permissions(subject, space).find(".//grant")
        found[subject] = set() if grant is None else allowed(grant)
    return found


def first_grant(document: etree._Element) -> etree._Element:
    grant = document.find(".//grant")
    assert grant is not None
    return grant


def rules_of(grant: etree._Element) -> list[etree._Element]:
    return [each for each in grant.iterfind("*") if each.tag in {"allow_rule", "deny_rule"}]


def new_grant(like: etree._Element, subject: str, rules: str, name: str = "/other") -> etree._Element:
    """Return a grant for a subject name with the dates of another, and with rules as XML."""
    grant = deepcopy(like)
    grant.set("name", name)
    subject_name = grant.find("subject_name")
    assert subject_name is not None
    subject_name.text = subject
    for each in rules_of(grant):
        grant.remove(each)
    default = grant.find("default")
    assert default is not None
    for each in etree.fromstring(f"<r>{rules}</r>"):
        default.addprevious(each)
    return grant


def each_pair(subjects: Sequence[str] = SUBJECTS) -> Iterator[tuple[str, str]]:
    return ((one, two) for one in subjects for two in subjects if one != two)
