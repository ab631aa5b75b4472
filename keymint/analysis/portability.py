# SPDX-License-Identifier: Apache-2.0
"""Check with a build type whether the rules of a policy can be compiled portably, without a package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import datetime, timedelta

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.steps import step_limit
from keymint.analysis.findings import undecided, warning
from keymint.analysis.subject_patterns import with_distinct_rules
from keymint.api import (
    BuildOptions,
    BuildType,
    CertificateSpec,
    DomainRange,
    DomainRule,
    Governance,
    Grant,
    KeySpec,
    Package,
    Validity,
)
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules

_RELAYS = ("relay", "ros_relay")
STEPS = 40_000_000
"""Steps after which no further subject is compiled (:mod:`comarmor.patterns.steps`)."""


def portability(
    build_type: BuildType, name: str, distro: str, subjects: Iterable[tuple[str, tuple[Rule, ...]]], now: datetime
) -> Iterator[Diagnostic]:
    """Yield rules of subjects that cannot be compiled portably for all vendors, or that compile to nothing.

    Args:
        build_type: compiles rules.
        name: its name.
        distro: ROS 2 distribution whose name mapping applies.
        subjects: subjects with their rules.
        now: the clock, UTC; the results do not depend on it.
    """
    reported: set[tuple[str, Origin | None, str]] = set()
    spent = 0
    for subject, rules in with_distinct_rules(subjects):
        if spent > STEPS:
            yield undecided(
                f"{subject} and the subjects after it were not compiled: {STEPS:,} steps were spent on those before it",
                None,
                "'keymint build' compiles each of them; or lint parts of the policy",
            )
            return
        with step_limit(None) as counter:
            package = package_of(name, distro, subject, rules, now)
            diagnostics = list(_of_package(build_type, package, reported))
        spent += counter.spent
        yield from diagnostics


def _of_package(
    build_type: BuildType, package: Package, reported: set[tuple[str, Origin | None, str]]
) -> Iterator[Diagnostic]:
    rules = package.grant.rules.rules
    places = {rule.origin.spot for rule in rules}
    for each in (*_relay_only(rules), *_built(build_type, package)):
        where = each.where
        if each.severity is Severity.NOTE or where is None or where.spot not in places:
            continue  # concerns the package, not its rules
        key = (each.code, where.alone(), each.message if each.code == "never-matches" else "")
        if key not in reported:
            reported.add(key)
            yield replace(each, severity=Severity.WARNING, subject=each.subject or package.subject)


def _built(build_type: BuildType, package: Package) -> tuple[Diagnostic, ...]:
    try:
        return build_type.build(package, BuildOptions()).diagnostics
    except KeymintError as error:
        return error.diagnostics


def _relay_only(rules: Iterable[Rule]) -> Iterator[Diagnostic]:
    for rule in rules:
        if rule.permissions and all(permission in _RELAYS for permission in rule.permissions):
            message = f"this {rule.effect} {rule.kind} rule only concerns relaying, which no DDS vendor enforces"
            yield warning("portability-relay", message, rule.origin, "control who may publish and subscribe instead")


def package_of(name: str, distro: str, subject: str, rules: tuple[Rule, ...], now: datetime) -> Package:
    """Return a package with valid defaults for all but its rules."""
    origin = Origin(subject)
    validity = Validity(now, now + timedelta(days=365))
    common_name = f"CN={subject}"
    everywhere = (DomainRange(0, 0),)
    protection = DomainRule(everywhere, False, True, "ENCRYPT", "ENCRYPT", "ENCRYPT", (), origin)
    return Package(
        name=subject.removeprefix("/"),
        subject=subject,
        build_type=name,
        distro=distro,
        identity=CertificateSpec(
            common_name, validity, None, "identity", "SHA256", KeySpec("ec", "SECP256R1"), (), origin
        ),
        grant=Grant("permissions", subject, common_name, validity, everywhere, SubjectRules(subject, rules), origin),
        governance=Governance("permissions", (protection,)),
    )
