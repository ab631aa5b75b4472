# SPDX-License-Identifier: Apache-2.0
"""Random access control of Zenoh routers, and identities on loopback that real sessions use."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID
from keymint_ros2_zenoh.documents.configuration import (
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Configuration,
    Flow,
    Message,
    Permission,
    write,
)
from keymint_ros2_zenoh.keyexpr import canonical

from .handmade import Authority

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
    authority: Authority

    @classmethod
    def new(cls, folder: Path) -> Identities:
        """Create an authority."""
        authority = Authority.new("authority")
        (folder / "ca.pem").write_bytes(authority.pem)
        return cls(folder, authority)

    def issue(self, file: str, common_name: str, *, server: bool = False) -> None:
        """Issue an identity: clientAuth alone for a node, serverAuth and names of loopback for a router.

        Args:
            file: name of the files.
            common_name: first common name of the subject.
            server: for a router.
        """
        usage = ExtendedKeyUsageOID.SERVER_AUTH if server else ExtendedKeyUsageOID.CLIENT_AUTH
        hosts = (x509.DNSName("localhost"), x509.IPAddress(IPv4Address("127.0.0.1"))) if server else ()
        certificate, key = self.authority.issue([(x509.NameOID.COMMON_NAME, common_name)], (usage,), hosts)
        (self.folder / f"{file}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
        (self.folder / f"{file}.key").write_bytes(key)

    def router(self, port: int, access_control: AccessControl) -> bytes:
        """Return the configuration of a router on loopback."""
        own = {"listen_certificate": f"{self.folder}/router.pem", "listen_key": f"{self.folder}/router.key"}
        return write(
            Configuration(
                mode="router",
                listen=(f"tls/127.0.0.1:{port}",),
                access_control=access_control,
                **self._tls(**own),
            ),
            (),
        )

    def session(self, port: int, file: str) -> bytes:
        """Return the configuration of a session, without access control of its own."""
        own = {"connect_certificate": f"{self.folder}/{file}.pem", "connect_key": f"{self.folder}/{file}.key"}
        endpoint = f"tls/localhost:{port}"
        return write(Configuration(mode="client", connect=(endpoint,), **self._tls(**own)), ())

    def _tls(self, **own: str) -> dict[str, Any]:
        return {
            "root_ca": f"{self.folder}/ca.pem", "mutual": True, "close_expired": True, "gossip": False,
            "multicast": False, **own,
        }  # fmt: skip


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
        cert_common_names=values(0.8, *NAMES, "/A", "/a/", "/ns"),
        interfaces=values(0.15, "lo", "eth9"),
        link_protocols=values(0.15, "tls", "tcp"),
    )


def _some(randomly: random.Random, ids: Sequence[str]) -> tuple[str, ...]:
    return tuple(randomly.sample(ids, randomly.randint(1, len(ids))))
