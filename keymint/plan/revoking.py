# SPDX-License-Identifier: Apache-2.0
"""Revoke the certificates of subjects: in the register, and in their sources, whose generation rises."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.text import counted, did_you_mean
from comarmor.values import dataclass
from keymint.api import RevocationReader
from keymint.changes import Action, Plan, Step
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.plan.enclaves import INSTALLED, installed
from keymint.plan.install import Leaving, withdraw
from keymint.plan.issuance import issuance_of, plan_issuance
from keymint.plan.register import complete_register, register_change
from keymint.register.register import SUPERSEDED, IssuedCertificate, Register
from keymint.session import Session

STAGE = "revoke"


@dataclass(frozen=True, slots=True)
class Revoking:
    """What a revocation does.

    Attributes:
        plan: the change of the register and of the sources, and the removal of enclaves without sources.
        certificates: the certificates that it revokes.
        packages: the packages whose sources change; they are to be built and installed again.
        diagnostics: what the revocation does not reach.
    """

    plan: Plan
    certificates: tuple[IssuedCertificate, ...]
    packages: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...]


def plan_revocation(session: Session, names: Sequence[str], reason: str) -> Revoking:
    """Plan the revocation of all certificates of some subjects that are in force.

    A revocation that a killed run began is completed.

    Args:
        session: the workspace and its profile.
        names: packages; those without sources have certificates in the register.
        reason: one of :data:`keymint.register.register.REASONS`.

    Raises:
        KeymintError: a package never had a certificate, or the register is missing and cannot be restored.
    """
    register = complete_register(session)
    with_sources = frozenset(session.packages())
    for name in names:
        _require_known(session, register, name)
    certificates = tuple(each for name in names for each in register.in_force(name, session.now))
    after = register.with_revoked(certificates, reason, session.now)
    packages: list[str] = []
    issuances = {}
    for name in names:
        if name in with_sources:
            own, lowest = issuance_of(session, name), after.generation(name)
            if own.generation < lowest:
                issuances[name] = replace(own, generation=lowest)
            packages.append(name)
    plan = Plan((), session.state, first=register_change(session, after))
    plan = plan.then(plan_issuance(session, STAGE, issuances, f"{reason}, new generation"))
    orphans = [name for name in names if name not in with_sources]
    leaving = Leaving({}, frozenset(orphans))
    steps = [withdraw(session, name, reason, leaving) for name in orphans if name in installed(session)]
    steps += [Step(STAGE, name, Action.UPDATED, detail=reason) for name in orphans if name not in installed(session)]
    plan = plan.then(Plan(tuple(steps), plan.state.updated(INSTALLED, {}, orphans)))
    return Revoking(plan, certificates, tuple(packages), tuple(_limits(session, certificates, packages, reason)))


def _require_known(session: Session, register: Register, name: str) -> None:
    if register.of(name):
        return
    known = sorted({each.name for each in register.certificates.values() if each.name})
    raise KeymintError(
        f"{subject_of(name)} never had a certificate here",
        where=session.package_marker(name) if name in session.packages() else None,
        help=did_you_mean(name, known, "'keymint issued' lists the certificates"),
        code="package-unknown" if name not in session.packages() else "certificate-none",
    )


def require_revoked(session: Session, names: Sequence[str], reason: str) -> None:
    """Require that packages without a certificate in force were revoked for a reason: then there is nothing to do.

    Args:
        session: the workspace and its profile.
        names: packages that had certificates.
        reason: the reason.

    Raises:
        KeymintError: the last certificate of one expired, or was revoked for another reason.
    """
    register = complete_register(session)
    for name in names:
        last = register.of(name)[-1]
        if last.revoked and last.reason == reason:
            continue
        if last.revoked:
            when = f"{last.revoked:%Y-%m-%d}"
            message = f"the last certificate of {subject_of(name)} was revoked on {when} already ({last.reason})"
        else:
            message = f"the last certificate of {subject_of(name)} expired on {last.not_after:%Y-%m-%d}"
        raise KeymintError(message, help="'keymint issued' lists the certificates", code="nothing-to-revoke")


def _limits(
    session: Session, certificates: Sequence[IssuedCertificate], packages: Sequence[str], reason: str
) -> list[Diagnostic]:
    """Return what stays possible although the certificates are revoked."""
    found: list[Diagnostic] = []
    profile = session.profile
    readers = [session.plugins.build_type(each, session.profile_marker()) for each in profile.build_types]
    of_lists = [each for each in readers if isinstance(each, RevocationReader)]
    if of_lists and not any(each.revocation_files(profile.distro, profile.layout, b"list") for each in of_lists):
        end = max((each.not_after for each in certificates), default=None)
        until = f" until {end:%Y-%m-%d}" if end else ""
        found.append(
            Diagnostic(
                "revocation-unread",
                Severity.WARNING,
                f"nodes of {profile.distro} with the layout {profile.layout!r} read no revocation list: whoever has "
                f"the revoked key is accepted{until}",
                session.profile_marker(),
                "replace the identity authority ('keymint authority replace'), or use Humble or later",
            )
        )
    same = [name for name in packages if not _has_generation(session, name)]
    if same and reason == SUPERSEDED:
        package = session.package(same[0])
        found.append(
            Diagnostic(
                "generation-none",
                Severity.WARNING,
                "the subject name has no generation: permissions that were signed before still fit the new certificate"
                + (f" [{counted(len(same), 'package')}]" if len(same) > 1 else ""),
                package.grant.defaults_origin or Origin(session.package_marker(same[0]).file),
                "write {unique} into both subject names (--subject-format unique), or renew with --rekey and another "
                "identity authority",
                package.subject,
            )
        )
    return found


def _has_generation(session: Session, name: str) -> bool:
    """Tell whether the subject name of a package changes with its generation."""
    package = session.package(name)
    before = package.issuance.generation
    plan = plan_issuance(session, STAGE, {name: replace(package.issuance, generation=before + 1)})
    return session.after(plan).package(name).identity.subject_name != package.identity.subject_name
