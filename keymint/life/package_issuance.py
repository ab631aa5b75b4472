# SPDX-License-Identifier: Apache-2.0
"""What an authority decided about the certificate of each package: planned into its sources, e.g. a revocation.

A revocation is written into the register as well, and raises the generation in the sources.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from comarmor.text import did_you_mean, quantity
from comarmor.values import Data, replace
from keymint.api import Issuance
from keymint.errors import Diagnostic, KeymintError, require_none
from keymint.life.register import SUPERSEDED, IssuedCertificate, Register
from keymint.life.workspace_register import complete_register, register_change
from keymint.names import subject_of
from keymint.store.changes import Action, Plan, Step, folder_changes
from keymint.view.stamps import digest
from keymint.workspace.installed_enclaves import INSTALLED, EnclaveChanges, enclave_names, withdraw
from keymint.workspace.session import Session

_CREATE = "create"
"""Key of the record of the stage that made the packages."""


def plan_issuance(session: Session, stage: str, new: Mapping[str, Issuance], detail: str = "") -> Plan:
    """Plan to write what the authority decided about some packages into their sources.

    Args:
        session: the workspace and its profile.
        stage: name of the stage in the steps, i.e. the verb.
        new: what the authority decided, by package.
        detail: a few words for the user, for each step.

    Raises:
        KeymintError: the type of the packages keeps no such decisions, a generation falls, or the certificate of a
            package would get a serial number twice.
    """
    if not session.package_type.ISSUANCE:
        raise KeymintError(
            f"packages of the type {session.profile.package_type!r} do not keep what an authority decides, so they can "
            "neither be renewed nor revoked",
            where=session.profile_marker(),
            help="change their sources by hand, then run 'keymint build' and 'keymint install'",
            code="issuance-unsupported",
        )
    require_none(error for name, issuance in new.items() for error in _defects(session, name, issuance))
    steps: list[Step] = []
    state, stamps = session.state, {}
    for name, issuance in new.items():
        written = session.package_type.with_issuance(issuance)
        changes = folder_changes(session.tree, session.workspace.src / name, written)
        steps.append(Step(stage, name, Action.UPDATED if changes else Action.UNCHANGED, changes, detail))
        # The stage that made the package must not take the file for an edit of its owner.
        if changes and (stamp := state.stamp(_CREATE, name)):
            outputs = {**stamp.outputs, **{file: digest(content) for file, content in written.items()}}
            stamps[name] = replace(stamp, outputs=outputs)
    return Plan(tuple(steps), state.updated(_CREATE, stamps) if stamps else state)


def _defects(session: Session, name: str, new: Issuance) -> Iterator[Diagnostic]:
    """Yield why the authority must not decide this about a package."""
    before, subject = session.issuance(name), subject_of(name)
    if new.generation < before.generation:
        message = f"has generation {before.generation}, and would fall to {new.generation}"
        where = session.issuance_place(name)
        yield Diagnostic.error("generation-falls", message, where, "never lower a generation", subject)
        return
    identity = session.package(name).identity
    if identity.serial is not None and (new.generation, new.renewed) != (before.generation, before.renewed):
        message = f"the sources give the serial number {identity.serial}, so the certificate cannot be issued again"
        help_ = "leave <serial_number> out or empty, so that each certificate gets a number of its own"
        yield Diagnostic.error("serial-fixed", message, identity.origin, help_, subject)


STAGE = "revoke"


class Revoking(Data):
    """What a revocation does.

    Attributes:
        plan: the change of the register and of the sources, and the removal of enclaves without sources.
        certificates: the certificates that it revokes.
        packages: the packages whose sources change; they are to be built and installed again.
        skipped: for each subject without a certificate to revoke, why.
        diagnostics: what the revocation does not reach.
    """

    plan: Plan
    certificates: tuple[IssuedCertificate, ...]
    packages: tuple[str, ...]
    skipped: tuple[Diagnostic, ...]
    diagnostics: tuple[Diagnostic, ...]


def plan_revocation(session: Session, names: Sequence[str], reason: str) -> Revoking:
    """Plan the revocation of all certificates of some subjects that are in force.

    Of a key that is given up also a certificate that expired: it must not be renewed. A revocation that a killed run
    began is completed.

    Args:
        session: the workspace and its profile.
        names: packages; those without sources have certificates in the register.
        reason: one of :data:`keymint.life.register.REASONS`.

    Raises:
        KeymintError: a package never had a certificate, or the register is missing and cannot be restored.
    """
    register = complete_register(session, [name for name in names if name in enclave_names(session)])
    with_sources = frozenset(session.packages())
    of_name: dict[str, tuple[IssuedCertificate, ...]] = {}
    for name in names:
        _require_known(session, register, name)
        last = () if reason == SUPERSEDED else register.of(name)[-1:]
        of_name[name] = register.in_force(name, session.now) or tuple(each for each in last if each.revoked is None)
    certificates = tuple(each for of_one in of_name.values() for each in of_one)
    after = register.with_revoked(certificates, reason, session.now)
    packages = tuple(name for name in names if name in with_sources)
    lowest = {name: after.generation(name) for name in packages}
    low = {name: own for name in packages if (own := session.issuance(name)).generation < lowest[name]}
    issuances = {name: replace(own, generation=lowest[name]) for name, own in low.items()}
    plan = Plan((), session.state, first=register_change(session, after))
    plan = plan.then(plan_issuance(session, STAGE, issuances, f"{reason}, new generation"))
    orphans = [name for name in names if name not in with_sources]
    changes = EnclaveChanges(removed=frozenset(orphans))
    installed = enclave_names(session)
    steps = [withdraw(session, name, reason, changes) for name in orphans if name in installed]
    steps += [Step(STAGE, name, Action.UPDATED, detail=reason) for name in orphans if name not in installed]
    plan = plan.then(Plan(tuple(steps), plan.state.updated(INSTALLED, {}, orphans)))
    without = [register.of(name)[-1] for name, of_one in of_name.items() if not of_one]
    skipped = tuple(_nothing_to_revoke(last) for last in without if last.revoked is None or last.reason != reason)
    return Revoking(plan, certificates, packages, skipped, tuple(_limits(session, certificates, packages, reason)))


def _require_known(session: Session, register: Register, name: str) -> None:
    if register.of(name):
        return
    known = {each.name for each in register.certificates.values() if each.name and name not in session.packages()}
    raise KeymintError(
        f"{subject_of(name)} never had a certificate here",
        where=session.package_marker(name) if name in session.packages() else None,
        help=did_you_mean(name, known, "'keymint issued' lists the certificates"),
        code="package-unknown" if name not in session.packages() else "certificate-none",
    )


def _nothing_to_revoke(last: IssuedCertificate) -> Diagnostic:
    """Return the warning that a subject has no certificate to revoke, whose last one this is."""
    subject, why = subject_of(last.name), f"expired on {last.not_after:%Y-%m-%d}"
    if last.revoked:
        why = f"was revoked on {last.revoked:%Y-%m-%d} already ({last.reason})"
    message, help_ = f"the last certificate of {subject} {why}", "'keymint issued' lists the certificates"
    return Diagnostic.warning("nothing-to-revoke", message, None, help_, subject)


def _limits(
    session: Session, certificates: Sequence[IssuedCertificate], packages: Sequence[str], reason: str
) -> Iterator[Diagnostic]:
    """Yield what stays possible although the certificates are revoked."""
    profile = session.profile
    files = [each.revocation_files(profile.distro, profile.layout, b"list") for each in session.build_types.values()]
    of_lists = [each for each in files if each is not None]
    if of_lists and not any(of_lists):
        end = max((each.not_after for each in certificates), default=None)
        until = f" until {end:%Y-%m-%d}" if end else ""
        yield Diagnostic.warning(
            "revocation-unread",
            f"nodes of {profile.distro} with the layout {profile.layout!r} read no revocation list: whoever has the "
            f"revoked key is accepted{until}",
            session.profile_marker(),
            "replace the identity authority ('keymint authority replace'), or use Humble or later",
        )
    of_keys = dict.fromkeys((each.name, each.key) for each in certificates if each.key and reason != SUPERSEDED)
    by_name = [name for name, _ in of_keys]
    for name in [each for each in packages if by_name.count(each) > 1]:
        message = f"this gives up the new key of {subject_of(name)} as well as those that it replaced"
        help_ = f"'keymint renew --rekey {name}' makes another; --reason superseded would have spared the new one"
        yield Diagnostic.warning("keys-given-up", message, None, help_, subject_of(name))
    same = [name for name in packages if not _has_generation(session, name)]
    if same:
        fit = "still match the new certificate" if reason == SUPERSEDED else "would match a later certificate as well"
        package = session.package(same[0])
        yield Diagnostic.warning(
            "generation-none",
            f"the subject name has no generation: permissions signed before {fit}"
            + (f" [{quantity(len(same), 'package')}]" if len(same) > 1 else ""),
            package.grant.defaults_origin or session.package_marker(same[0]),
            "write {unique} into both subject names (--subject-format unique), or run 'keymint renew --rekey NAME' "
            "with another identity authority",
            package.subject,
        )


def _has_generation(session: Session, name: str) -> bool:
    """Tell whether the subject name of a package changes with its generation."""
    package = session.package(name)
    before = package.issuance.generation
    plan = plan_issuance(session, STAGE, {name: replace(package.issuance, generation=before + 1)})
    return session.after(plan).package(name).identity.subject_name != package.identity.subject_name
