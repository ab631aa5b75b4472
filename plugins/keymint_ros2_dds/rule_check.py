# SPDX-License-Identifier: Apache-2.0
"""Check the rules of a subject alone: what cannot be compiled portably for all vendors, or compiles to nothing."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import BuildOptions, CertificateSpec, DomainRange, Grant, KeySpec, Package, Validity
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint_ros2_dds.build import build
from keymint_ros2_dds.settings import BUILD_TYPE, DdsSettings, DomainRule, Governance

_RELAYS = ("relay", "ros_relay")
_VALIDITY = Validity(datetime(2000, 1, 1, tzinfo=UTC), datetime(2001, 1, 1, tzinfo=UTC))
"""Any period that documents can express: the findings on rules do not depend on it."""
_EVERYWHERE = (DomainRange(0, 0),)
_ANYWHERE = Origin(BUILD_TYPE)
_PROTECTION = DomainRule(_EVERYWHERE, False, True, "ENCRYPT", "ENCRYPT", "ENCRYPT", (), _ANYWHERE)


def check_rules(rules: SubjectRules, distro: str) -> tuple[Diagnostic, ...]:
    """Return findings on the rules of a subject: see :meth:`keymint.api.RuleCheck.check_rules`."""
    try:
        built = build(package_of(rules, distro), BuildOptions()).diagnostics
    except KeymintError as error:
        built = error.diagnostics
    places = {rule.origin.spot for rule in rules.rules}
    of_rules = (each for each in built if each.where is not None and each.where.spot in places)
    return (*_relay_only(rules), *of_rules)


def _relay_only(rules: SubjectRules) -> Iterator[Diagnostic]:
    for rule in rules.rules:
        if rule.permissions and all(permission in _RELAYS for permission in rule.permissions):
            message = f"this {rule.effect} {rule.kind} rule only concerns relaying, which no DDS vendor enforces"
            help_ = "control who may publish and subscribe instead"
            yield Diagnostic("portability-relay", Severity.WARNING, message, rule.origin, help_, rules.subject)


def package_of(rules: SubjectRules, distro: str) -> Package:
    """Return a package with these rules, and with valid settings for all else."""
    subject = rules.subject
    origin = Origin(subject)
    common_name = f"CN={subject}"
    return Package(
        name=subject.removeprefix("/"),
        subject=subject,
        distro=distro,
        identity=CertificateSpec(
            common_name, _VALIDITY, None, "identity", "SHA256", KeySpec("ec", "SECP256R1"), (), origin
        ),
        grant=Grant("permissions", subject, common_name, _VALIDITY, _EVERYWHERE, rules, origin),
        build_types=(BUILD_TYPE,),
        settings={BUILD_TYPE: DdsSettings(Governance("permissions", (_PROTECTION,)))},
    )
