# SPDX-License-Identifier: Apache-2.0
"""Packages of a workspace with a router, as a package type would load them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from keymint_ros2_zenoh.settings import BUILD_TYPE, Router, ZenohSettings

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.api import CertificateSpec, DomainRange, Extension, Grant, KeySpec, Package, Role, Validity
from keymint.ir import Rule, SubjectRules

ORIGIN = Origin("policy.xml", 7)
VALIDITY = Validity(datetime(2026, 11, 20, tzinfo=UTC), datetime(2027, 11, 20, tzinfo=UTC))
DOMAIN = (DomainRange(0, 0),)
HOST_ORIGIN = Origin("profile/package.defaults/zenoh.xml", 5)
ROUTER = Router("zenoh_router", "localhost", 7447, HOST_ORIGIN)
P256 = KeySpec("ec", "SECP256R1")
KEYSTORE = "/opt/robot/install"


def rule(effect: str, kind: str, permissions: str, *expressions: str, line: int = 7) -> Rule:
    origin = Origin("policy.xml", line)
    return Rule(Effect(effect), kind, tuple(permissions.split()), expressions, (), False, origin)


def package(
    *rules: Rule,
    subject: str = "/talker",
    name: str = "",
    router: Router = ROUTER,
    key: KeySpec = P256,
    extensions: tuple[Extension, ...] = (),
    **fields: Any,
) -> Package:
    """Return a package of an enclave; ``fields`` are those of its grant."""
    is_router = subject == f"/{router.name}"
    usage = Extension("extendedKeyUsage", "serverAuth" if is_router else "clientAuth", False, HOST_ORIGIN)
    host = Extension("subjectAltName", f"DNS:{router.host}", False, HOST_ORIGIN)
    subject_name = name or f"CN={subject},OU=x1"
    origin = Origin(f"src{subject}/identities.xml", 3)
    identity = CertificateSpec(
        subject_name,
        VALIDITY,
        None,
        "identity_ca",
        "SHA256",
        key,
        extensions or ((usage, host) if is_router else (usage,)),
        origin,
    )
    grant = Grant("permissions_ca", subject, subject_name, None, DOMAIN, SubjectRules(subject, rules), ORIGIN)
    return Package(
        subject[1:],
        subject,
        "jazzy",
        identity,
        replace(grant, **fields),
        (BUILD_TYPE,),
        {BUILD_TYPE: ZenohSettings(router, KEYSTORE)},
        role=Role.INFRASTRUCTURE if is_router else Role.SUBJECT,
    )


def router_package(**fields: Any) -> Package:
    return package(subject="/zenoh_router", **fields)


def workspace(*packages: Package, router: Package | None = None) -> tuple[Package, ...]:
    """Return packages with their router, sorted by name, each of which knows the router."""
    own = router or router_package()
    return tuple(connected(sorted((*packages, own), key=lambda each: each.name), own))


def connected(packages: Iterable[Package], router: Package) -> Iterable[Package]:
    return (replace(each, infrastructure=(router,)) for each in packages)


TALKER = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
LISTENER = package(rule("ALLOW", "ros_topic", "ros_subscribe", "/chatter"), subject="/robot/listener")
