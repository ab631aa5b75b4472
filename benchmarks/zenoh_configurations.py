# SPDX-License-Identifier: Apache-2.0
"""Random access control of Zenoh routers, and identities on loopback that real sessions use."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import IPv4Address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID
from keymint_ros2_zenoh.documents.access_control import AccessControl, AclPolicy, AclRule, AclSubject
from keymint_ros2_zenoh.keyexpr.key_expr import canonical
from keymint_ros2_zenoh.messages import Flow, Message, Permission

NAMES = ("/a", "/b", "/ns/a")
"""Common names of the sessions."""
ROUTER = "zenoh_router"
FENCE = "fence"
"""First chunk of keys that mark the end of a batch; no random rule has it."""
_CHUNKS = ("a", "b", "ab", "abc", "x", "@v", "@adv")
_WILD = ("*", "**", "$*b", "a$*", "a$*c", "*", "**", "a$*")

_IN_DOMAIN = 0.8
"""Share of key expressions that begin as all keys do."""


@dataclass(frozen=True, slots=True)
class Identities:
    """A folder with an authority and the identities that it issued: ``<name>.pem`` and ``<name>.key``."""

    folder: Path
    authority: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def new(cls, folder: Path) -> Identities:
        """Create an authority."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name.from_rfc4514_string("CN=authority")
        builder = _builder(name, name, key).add_extension(x509.BasicConstraints(ca=True, path_length=None), True)
        certificate = builder.sign(key, hashes.SHA256())
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "ca.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
        return cls(folder, certificate, key)

    def issue(
        self,
        file: str,
        common_name: str,
        *,
        server: bool = False,
        seconds: float = 864_000.0,
    ) -> None:
        """Issue an identity: clientAuth alone for a node, serverAuth and names of loopback for a router.

        Args:
            file: name of its files, without suffix.
            common_name: common name.
            server: it is a router's.
            seconds: how long it is valid from now.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, common_name)])
        usage = ExtendedKeyUsageOID.SERVER_AUTH if server else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = _builder(subject, self.authority.subject, key, seconds)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        if server:
            names = [x509.DNSName("localhost"), x509.IPAddress(IPv4Address("127.0.0.1"))]
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        certificate = builder.sign(self.key, hashes.SHA256())
        secret = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        (self.folder / f"{file}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
        (self.folder / f"{file}.key").write_bytes(secret)

    def router(self, port: int, access_control: AccessControl | None, file: str = "router") -> dict[str, object]:
        """Return the configuration of a router on loopback, in the shape that Keymint writes."""
        tls = {
            "root_ca_certificate": str(self.folder / "ca.pem"),
            "listen_certificate": str(self.folder / f"{file}.pem"),
            "listen_private_key": str(self.folder / f"{file}.key"),
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
        return {
            "mode": "router",
            "listen": {"endpoints": [f"tls/127.0.0.1:{port}"]},
            **_QUIET,
            "transport": {"link": {"tls": tls}},
            **({} if access_control is None else {"access_control": document(access_control)}),
        }

    def session(self, port: int, file: str, access_control: AccessControl | None = None) -> dict[str, object]:
        """Return the configuration of a session, in the shape that Keymint writes."""
        tls = {
            "root_ca_certificate": str(self.folder / "ca.pem"),
            "connect_certificate": str(self.folder / f"{file}.pem"),
            "connect_private_key": str(self.folder / f"{file}.key"),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
        return {
            "mode": "client",
            "connect": {"endpoints": [f"tls/localhost:{port}"]},
            "listen": {"endpoints": []},
            **_QUIET,
            "transport": {"link": {"tls": tls}},
            **({} if access_control is None else {"access_control": document(access_control)}),
        }


_QUIET: Mapping[str, object] = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}


def document(control: AccessControl) -> dict[str, object]:
    """Return access control as Zenoh reads it."""
    properties = {
        "cert_common_names": "common_names",
        "interfaces": "interfaces",
        "link_protocols": "protocols",
        "usernames": "usernames",
        "zids": "zids",
    }
    return {
        "enabled": control.enabled,
        "default_permission": control.default_permission,
        "rules": [
            {
                "id": rule.id,
                "messages": list(rule.messages),
                "flows": list(rule.flows),
                "permission": rule.permission,
                "key_exprs": list(rule.key_exprs),
            }
            for rule in control.rules
        ],
        "subjects": [
            {
                "id": subject.id,
                **{
                    name: list(getattr(subject, field)) for name, field in properties.items() if getattr(subject, field)
                },
            }
            for subject in control.subjects
        ],
        "policies": [{"rules": list(each.rules), "subjects": list(each.subjects)} for each in control.policies],
    }


def random_access_control(randomly: random.Random) -> AccessControl:
    """Return random rules, subjects (several of which match one session, some of them wildcards) and policies."""
    rules = tuple(
        AclRule(
            f"r{number}",
            tuple(randomly.sample(list(Message), randomly.randint(1, len(Message)))),
            tuple(randomly.sample(list(Flow), randomly.randint(1, 2))),
            randomly.choice([Permission.ALLOW, Permission.ALLOW, Permission.DENY]),
            tuple(dict.fromkeys(random_key_expr(randomly) for _ in range(randomly.randint(1, 3)))),
        )
        for number in range(randomly.randint(1, 8))
    )
    subjects = tuple(_random_subject(randomly, number) for number in range(randomly.randint(1, 4)))
    policies = tuple(
        AclPolicy(_some(randomly, [rule.id for rule in rules]), _some(randomly, [subject.id for subject in subjects]))
        for _ in range(randomly.randint(1, 4))
    )
    default = randomly.choice([Permission.DENY, Permission.DENY, Permission.ALLOW])
    return AccessControl(enabled=True, default_permission=default, rules=rules, subjects=subjects, policies=policies)


def random_key_expr(randomly: random.Random, *, literal: bool = False) -> str:
    """Return a random key expression in canonical form, over few chunks so that many of them meet."""
    choices = _CHUNKS if literal else (*_CHUNKS, *_WILD)
    chunks = [randomly.choice(choices) for _ in range(randomly.randint(1, 3))]
    in_domain = literal or randomly.random() < _IN_DOMAIN
    return canonical("/".join(["0", *chunks] if in_domain else chunks)).text


def _random_subject(randomly: random.Random, number: int) -> AclSubject:
    def values(chance: float, *choices: str) -> tuple[str, ...]:
        if randomly.random() > chance:
            return ()
        return tuple(randomly.sample(choices, randomly.randint(1, min(2, len(choices)))))

    return AclSubject(
        f"s{number}",
        common_names=values(0.8, *NAMES, "/A", "/a/", "/ns"),
        interfaces=values(0.15, "lo", "eth9"),
        protocols=values(0.15, "tls", "tcp"),
    )


def _some(randomly: random.Random, ids: Sequence[str]) -> tuple[str, ...]:
    return tuple(randomly.sample(ids, randomly.randint(1, len(ids))))


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, seconds: float = 864_000.0
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number())
    return builder.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(seconds=seconds))


def write(configuration: Mapping[str, object]) -> bytes:
    """Return a configuration as a document."""
    return json.dumps(configuration).encode()
