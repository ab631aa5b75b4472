"""What a build type says of the rules of a policy, before there is any package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.steps import step_limit
from keymint.api import (
    BuildOptions,
    BuildType,
    CertificateSpec,
    DomainRange,
    DomainRule,
    Governance,
    KeySpec,
    Package,
    Permissions,
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
    """Yield what cannot be built of the rules of subjects so that all vendors read it alike, or is built to nothing.

    Args:
        build_type: compiles rules.
        name: its name.
        distro: ROS 2 distribution whose name mapping applies.
        subjects: subjects with their rules.
        now: the clock, UTC; nothing that is said depends on it.
    """
    said: set[tuple[str, Origin | None, str]] = set()
    spent = 0
    for subject, rules in _different(subjects):
        if spent > STEPS:
            yield _given_up(subject)
            return
        with step_limit(None) as effort:
            found = list(_of_subject(build_type, _Asked(name, distro, subject, rules, now), said))
        spent += effort.spent
        yield from found


@dataclass(frozen=True, slots=True)
class _Asked:
    """The rules of a subject, and what the build type needs to know beside them."""

    name: str
    distro: str
    subject: str
    rules: tuple[Rule, ...]
    now: datetime


def _different(subjects: Iterable[tuple[str, tuple[Rule, ...]]]) -> Iterator[tuple[str, tuple[Rule, ...]]]:
    """Yield subjects, of those with the very same rules the first: nothing else is asked about."""
    seen: dict[tuple[int, ...], tuple[Rule, ...]] = {}  # which holds the rules, so that no other ones get their ids
    for subject, rules in subjects:
        key = tuple(map(id, rules))
        if key not in seen:
            seen[key] = rules
            yield subject, rules


def _given_up(subject: str) -> Diagnostic:
    return Diagnostic(
        "lint-unknown",
        Severity.NOTE,
        f"{subject} and the subjects after it were not compiled: {STEPS:,} steps were spent on those before it",
        None,
        "'keymint build' compiles each of them; or lint parts of the policy",
    )


def _of_subject(
    build_type: BuildType, asked: _Asked, said: set[tuple[str, Origin | None, str]]
) -> Iterator[Diagnostic]:
    places = {rule.origin.spot for rule in asked.rules}
    package = package_of(asked.name, asked.distro, asked.subject, asked.rules, asked.now)
    for found in (*_relaying(asked.rules), *_built(build_type, package)):
        where = found.where
        if found.severity is Severity.NOTE or where is None or where.spot not in places:
            continue  # it is about what only a package has
        key = (found.code, where.alone(), found.message if found.code == "never-matches" else "")
        if key not in said:
            said.add(key)
            yield replace(found, severity=Severity.WARNING, subject=found.subject or asked.subject)


def _built(build_type: BuildType, package: Package) -> tuple[Diagnostic, ...]:
    try:
        return build_type.build(package, BuildOptions()).diagnostics
    except KeymintError as error:
        return error.diagnostics


def _relaying(rules: Iterable[Rule]) -> Iterator[Diagnostic]:
    for rule in rules:
        if rule.permissions and all(permission in _RELAYS for permission in rule.permissions):
            yield Diagnostic(
                "portability-relay",
                Severity.WARNING,
                f"this {rule.effect} {rule.kind} rule is about relaying only, which no vendor of DDS decides",
                rule.origin,
                "say who may publish and subscribe instead",
            )


def package_of(name: str, distro: str, subject: str, rules: tuple[Rule, ...], now: datetime) -> Package:
    """Return a package that has nothing to complain of but its rules."""
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
        permissions=Permissions(
            "permissions", subject, common_name, validity, everywhere, SubjectRules(subject, rules), origin
        ),
        governance=Governance("permissions", (protection,)),
    )
