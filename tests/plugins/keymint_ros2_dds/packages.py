# SPDX-License-Identifier: Apache-2.0
"""Packages to build, as a package type would load them."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from keymint_ros2_dds.settings import BUILD_TYPE, DdsSettings, DomainRule, TopicProtection, settings_of

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.api import CertificateSpec, DomainRange, Grant, KeySpec, Package, Validity
from keymint.ir import Rule, SubjectRules

ORIGIN = Origin("policy.xml", 7)
VALIDITY = Validity(datetime(2026, 11, 20, tzinfo=UTC), datetime(2027, 11, 20, tzinfo=UTC))
DOMAIN = (DomainRange(0, 0),)


def rule(effect: str, kind: str, permissions: str, *expressions: str, partitions=(), line: int = 7) -> Rule:
    origin = Origin("policy.xml", line)
    return Rule(Effect(effect), kind, tuple(permissions.split()), expressions, tuple(partitions), False, origin)


def protection(kind: str = "topic", expression: str = "*", **fields) -> TopicProtection:
    every = TopicProtection(kind, expression, ORIGIN)
    return replace(every, **fields)


def domain_rule(*topics: TopicProtection, **fields) -> DomainRule:
    usual = DomainRule(DOMAIN, topics or (protection(),), ORIGIN)
    return replace(usual, **fields)


def package(*rules: Rule, subject: str = "/talker", distro: str = "jazzy", name: str = "", **fields) -> Package:
    """Return a package; ``fields`` are those of its permissions."""
    subject_name = name or f"OU=x1,CN={subject}"
    key = KeySpec("ec", "SECP256R1")
    identity = CertificateSpec(subject_name, VALIDITY, None, "identity_ca", "SHA256", key, (), ORIGIN)
    usual = Grant("permissions_ca", subject, subject_name, VALIDITY, DOMAIN, SubjectRules(subject, rules), ORIGIN)
    governance = DdsSettings("permissions_ca", (domain_rule(),))
    grant = replace(usual, **fields)
    return Package(subject[1:], subject, distro, identity, grant, (BUILD_TYPE,), {BUILD_TYPE: governance})


def governed(loaded: Package, **fields) -> Package:
    """Return a package with another governance; ``fields`` are those that differ."""
    governance = replace(settings_of(loaded), **fields)
    return replace(loaded, settings={BUILD_TYPE: governance})
