# SPDX-License-Identifier: Apache-2.0
"""Install spaces for Zenoh written by hand, in the sound shape, for tests of the model and of real software.

Nothing of the compiler is used: a right is written as the messages that it needs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID

from keymint.api import InstalledEnclave

ROUTER = "zenoh_router"
_IN, _OUT = ["ingress"], ["egress"]
NEEDED: Mapping[str, Sequence[tuple[Sequence[str], Sequence[str], str]]] = {
    "publish": (
        (["put", "reply"], _IN, ""),
        (["declare_subscriber"], _OUT, ""),
        (["put", "declare_queryable", "liveliness_token"], _IN, "/@adv/**"),
        (["declare_subscriber", "query"], _OUT, "/@adv/**"),
    ),
    "subscribe": (
        (["declare_subscriber"], _IN, ""),
        (["put", "reply"], _OUT, ""),
        (["declare_subscriber", "query", "declare_liveliness_subscriber"], _IN, "/@adv/**"),
        (["put", "liveliness_token"], _OUT, "/@adv/**"),
    ),
    "call": ((["query"], _IN, ""), (["reply", "declare_queryable"], _OUT, "")),
    "execute": ((["declare_queryable", "reply"], _IN, ""), (["query"], _OUT, "")),
}
"""Messages, flows and what follows the key, by permission (measured on Zenoh 1.10.2)."""
ALL = ("put", "delete", "declare_subscriber", "query", "reply", "declare_queryable", "liveliness_token",
       "liveliness_query", "declare_liveliness_subscriber")  # fmt: skip


@dataclass
class InstallSpace:
    """An install space with an authority; :meth:`write` writes its files.

    Attributes:
        folder: where.
        rights: rules (permission, key expression) by subject. ``deny`` denies all messages.
        names: common name of a subject's certificate, if it is not the subject.
        changes: what of the configuration of a subject's session, or of the router (``""``), is different.
        lives: how many seconds the certificate of a subject is valid from now, if not ten days.
        port: the port of the router.
        authority_key: the private key of the authority.
    """

    folder: Path
    rights: Mapping[str, Sequence[tuple[str, str]]]
    names: dict[str, str] = field(default_factory=dict)
    changes: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    lives: dict[str, float] = field(default_factory=dict)
    port: int = 7447

    def __post_init__(self) -> None:
        self.authority_key = ec.generate_private_key(ec.SECP256R1())
        self._name = x509.Name.from_rfc4514_string("CN=authority")
        builder = self._builder(self._name, self.authority_key, 864_000.0)
        builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        self._certificate = builder.sign(self.authority_key, hashes.SHA256())

    @property
    def authority(self) -> bytes:
        """The certificate of the authority, PEM."""
        return self._certificate.public_bytes(serialization.Encoding.PEM)

    def write(self) -> list[InstalledEnclave]:
        """Write all files and return the enclaves of the subjects."""
        self.enclave(ROUTER, ROUTER, server=True)
        shared = self.folder / "zenoh"
        shared.mkdir(parents=True, exist_ok=True)
        (shared / "router.json5").write_text(json.dumps(merged(self.router(), self.changes.get("", {})), indent=1))
        enclaves = []
        for subject in self.rights:
            folder = self.enclave(subject[1:], self.names.get(subject, subject), seconds=self.lives.get(subject))
            document = merged(self.session(folder), self.changes.get(subject, {}))
            (folder / "session.json5").write_text(json.dumps(document, indent=1))
            enclaves.append(InstalledEnclave(subject, folder, "jazzy", self.folder))
        return enclaves

    def enclave(
        self,
        path: str,
        name: str,
        *,
        server: bool = False,
        both: bool = False,
        host: str = "localhost",
        seconds: float | None = None,
    ) -> Path:
        """Write certificate and key of an enclave and return its folder; see :meth:`issue`."""
        folder = self.folder / "enclaves" / path
        folder.mkdir(parents=True, exist_ok=True)
        certificate, key = self.issue(name, server=server, both=both, host=host, seconds=seconds)
        (folder / "cert.pem").write_bytes(certificate)
        (folder / "key.pem").write_bytes(key)
        (folder / "identity_ca.cert.pem").write_bytes(self.authority)
        return folder

    def issue(
        self,
        name: str,
        *,
        server: bool = False,
        both: bool = False,
        host: str = "localhost",
        seconds: float | None = None,
    ) -> tuple[bytes, bytes]:
        """Return certificate and key.

        Args:
            name: common name.
            server: for serverAuth only; otherwise for clientAuth only.
            both: for both, as enclaves of DDS have it.
            host: alternative name of a certificate for servers; empty for none.
            seconds: how long it is valid from now, if not ten days.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
        usages = [ExtendedKeyUsageOID.SERVER_AUTH] * (server or both)
        usages += [ExtendedKeyUsageOID.CLIENT_AUTH] * (both or not server)
        builder = self._builder(subject, key, 864_000.0 if seconds is None else seconds)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        if host and (server or both):
            builder = builder.add_extension(x509.SubjectAlternativeName([x509.DNSName(host)]), critical=False)
        pem = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        return builder.sign(self.authority_key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM), pem

    def router(self) -> dict[str, Any]:
        """Return the router's configuration."""
        rules, policies = [], []
        for subject, rights in self.rights.items():
            own = [rule for number, right in enumerate(rights) for rule in _rules(f"{subject} {number}", *right)]
            rules += own
            if own:
                policies.append({"rules": [rule["id"] for rule in own], "subjects": [subject]})
        names = {subject: self.names.get(subject, subject) for subject in self.rights}
        subjects = [{"id": subject, "cert_common_names": [name]} for subject, name in names.items()]
        folder = f"/robot/keystore/enclaves/{ROUTER}"
        document = {
            "mode": "router",
            "listen": {"endpoints": [f"tls/[::]:{self.port}"]},
            "transport": {"link": {"tls": {**_tls(folder, "listen"), "enable_mtls": True}}},
            "access_control": _access_control(rules, subjects, policies),
        }
        return merged(_QUIET, document)

    def installed_session(self, folder: Path) -> dict[str, Any]:
        """Return the configuration that is installed in the folder of an enclave."""
        document: dict[str, Any] = json.loads((folder / "session.json5").read_text())
        return document

    def session(self, folder: Path) -> dict[str, Any]:
        """Return the configuration of a session, pinned to the router's common name."""
        on_robot = f"/robot/keystore/{folder.relative_to(self.folder)}"
        everything = {"id": "all", "messages": list(ALL), "permission": "allow", "key_exprs": ["**", "**/@adv/**",
                      "@ros2_lv/**"]}  # fmt: skip
        pinned = [{"id": "router", "cert_common_names": [ROUTER]}]
        tls = {**_tls(on_robot, "connect"), "enable_mtls": True, "verify_name_on_connect": True}
        document = {
            "mode": "client",
            "connect": {"endpoints": [f"tls/localhost:{self.port}"]},
            "listen": {"endpoints": []},
            "transport": {"link": {"tls": tls}},
            "access_control": _access_control([everything], pinned, [{"rules": ["all"], "subjects": ["router"]}]),
        }
        return merged(_QUIET, document)

    def _builder(self, subject: x509.Name, key: ec.EllipticCurvePrivateKey, seconds: float) -> x509.CertificateBuilder:
        now = datetime.now(UTC)
        builder = x509.CertificateBuilder().subject_name(subject).issuer_name(self._name).public_key(key.public_key())
        builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - timedelta(days=1))
        return builder.not_valid_after(now + timedelta(seconds=seconds))


_QUIET = {
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    "timestamping": {"enabled": True},
    "transport": {"unicast": {"open_timeout": 60_000, "accept_timeout": 60_000}},
}
"""Settings of all configurations; the time limits are those of rmw_zenoh."""


def merged(document: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with changed members, at any depth."""
    result = dict(document)
    for name, value in changes.items():
        inner = result.get(name)
        result[name] = merged(inner, value) if isinstance(value, dict) and isinstance(inner, dict) else value
    return result


def key(name: str, domain: int = 0) -> str:
    """Return the key expression of a ROS name, or of an expression whose ``*`` are key expressions already."""
    return f"{domain}/{name.removeprefix('/')}/*/*"


def _rules(name: str, permission: str, key_expr: str) -> list[dict[str, Any]]:
    if permission == "deny":
        exprs = [key_expr] if key_expr.endswith("**") else [key_expr, f"{key_expr}/@adv/**"]
        return [_rule(name, ALL, ["ingress", "egress"], "deny", exprs)]
    return [
        _rule(f"{name}.{number}", messages, flows, "allow", [f"{key_expr}{suffix}"])
        for number, (messages, flows, suffix) in enumerate(NEEDED[permission])
    ]


def _rule(
    name: str, messages: Sequence[str], flows: Sequence[str], permission: str, exprs: Sequence[str]
) -> dict[str, Any]:
    return {"id": name, "messages": list(messages), "flows": list(flows), "permission": permission, "key_exprs": exprs}


def _tls(folder: str, role: str) -> dict[str, Any]:
    return {
        "root_ca_certificate": f"{folder}/identity_ca.cert.pem",
        f"{role}_certificate": f"{folder}/cert.pem",
        f"{role}_private_key": f"{folder}/key.pem",
        "close_link_on_expiration": True,
    }


def _access_control(rules: list[Any], subjects: list[Any], policies: list[Any]) -> dict[str, Any]:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }
