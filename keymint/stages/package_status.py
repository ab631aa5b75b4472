# SPDX-License-Identifier: Apache-2.0
"""The stage and validity of every package (``keymint status``), and which of them a renewal takes up."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import datetime

from comarmor.values import Data
from keymint.api import BuildOptions, LoadedPolicy, Role
from keymint.authority import authorities
from keymint.errors import Defects, Diagnostic, KeymintError, require_none
from keymint.life.renewal_schedule import CERTIFICATE, PERMISSIONS, enclave_terms, first_due
from keymint.life.terms import DEFAULT, Term, recorded_terms
from keymint.life.workspace_register import register_of, withdrawn
from keymint.names import name_of, subject_of
from keymint.stages import build, create, install
from keymint.stages.documents import built_documents, installed_shared, is_built
from keymint.stages.identities import missing_enclave
from keymint.stages.work import InstallRequest
from keymint.store.changes import Plan
from keymint.view.stamps import Stamp, State, stamp_of
from keymint.workspace.installed_enclaves import enclave_names, hidden, installed_certificate, orphans
from keymint.workspace.package_build_types import BUILD, is_build_current, record_key, users
from keymint.workspace.session import Session


class StatusRow(Data):
    """The status of one package, or of the documents over all packages of a build type.

    Attributes:
        package: its name; empty for such documents.
        stage: the last stage that it went through: ``source``, ``built`` or ``installed``; ``revoked`` if its
            certificate was revoked and its enclave removed; ``orphaned`` for an
            enclave without a source package, ``ignored`` for one whose package a KEYMINT_IGNORE hides.
        stale: the first verb that would do something for it, or empty.
        certificate_expires: end of validity of the installed certificate, UTC.
        permissions_expire: end of validity of the installed permissions, UTC.
        problem: one line when the package cannot be loaded, or the documents cannot be built.
        terms: what of the installed enclave ends; nothing if it is not installed, or that is not known.
        build_type: the build type of documents over all packages.
        documents: their paths relative to the install space, as they were built last.
    """

    package: str
    stage: str
    stale: str
    certificate_expires: datetime | None = None
    permissions_expire: datetime | None = None
    problem: str = ""
    terms: tuple[Term, ...] = ()
    build_type: str = ""
    documents: tuple[str, ...] = ()

    @property
    def renew_after(self) -> datetime | None:
        """From when on 'keymint renew' takes it up, UTC; None if it does not, before an authority is renewed."""
        first = first_due(self.terms)
        return first.renew_after(DEFAULT) if first else None

    @property
    def ends_with(self) -> str:
        """The authority that all its documents end with, so that it is the authority that is due; or empty."""
        is_cut = self.terms and all(each.is_cut for each in self.terms)
        return min(self.terms, key=lambda each: each.last).issuer if is_cut else ""


def package_rows(session: Session, policy: LoadedPolicy | None) -> tuple[StatusRow, ...]:
    """Return a row for every source package and every installed enclave, sorted by name.

    Args:
        session: the workspace and its profile.
        policy: its policy, or None if it cannot be loaded; then packages are not compared with it.
    """
    names = session.packages()
    enclaves = set(enclave_names(session))
    stale = _differing(session, policy, names)
    rows = [_row(session, stale, name, installed=name in enclaves) for name in names]
    rows += [
        StatusRow(name, "orphaned", "install --prune", _certificate_end(session, name)) for name in orphans(session)
    ]
    rows += [StatusRow(name, "ignored", "", _certificate_end(session, name)) for name in hidden(session)]
    return tuple(sorted(rows, key=lambda row: row.package))


def shared_rows(session: Session) -> tuple[StatusRow, ...]:
    """Return a row for each build type that has documents over all packages."""
    try:
        of_types = users(session)
    except KeymintError as error:
        return (StatusRow("", "source", "", problem=_in_words(error.diagnostics)),)
    return tuple(_shared_row(session, build_type) for build_type in of_types)


def _shared_row(session: Session, build_type: str) -> StatusRow:
    key = record_key(build_type)
    try:
        built = built_documents(session, key) if is_built(session, key) else {}
        there = installed_shared(session, built)
        current = bool(built) and install.is_current(session, key)
    except KeymintError as error:  # a file that is no file, or too large
        return StatusRow("", "source", "", problem=_in_words(error.diagnostics), build_type=build_type)
    stage = "source" if not built else "installed" if there else "built"
    is_stale = not built or not is_build_current(session, key)
    stale = "build" if is_stale else "" if current else "install"
    return StatusRow("", stage, stale, build_type=build_type, documents=tuple(built))


def _certificate_end(session: Session, name: str) -> datetime | None:
    certificate = installed_certificate(session, name)
    return certificate.not_valid_after_utc if certificate else None


def _row(session: Session, differing: Mapping[str, str], name: str, *, installed: bool) -> StatusRow:
    try:
        built = is_built(session, name)
        session.file_digests(name)
    except KeymintError as error:  # a file that is no file, or too large
        problem, end = _in_words(error.diagnostics), _certificate_end(session, name)
        return StatusRow(name, "installed" if installed else "source", "", end, None, problem)
    stage = "installed" if installed else "built" if built else "source"
    if name in withdrawn(session):
        stage = "revoked"
    stale, problem = ("create", differing[name]) if name in differing else ("", "")
    is_subject = current = False
    try:
        current = built and is_build_current(session, name)
        recorded_terms(session, name, session.state.stamp(BUILD, name) if current else None)  # tells defects
        is_subject = session.role(name) is Role.SUBJECT
    except KeymintError as error:
        stale, problem = "create", _in_words(error.diagnostics)
    stale = stale or ("" if current else "build")
    if not stale and stage == "revoked":
        return StatusRow(name, stage, "", problem=problem)
    current = not stale and installed and install.is_current(session, name)
    if not current:
        is_unknown = session.tree.is_left_out(session.workspace.identity_key(name))
        stale = stale or ("" if installed and is_unknown else "install")
    terms: tuple[Term, ...] = ()
    if installed:
        with contextlib.suppress(KeymintError):  # the package has defects, which are its problem
            terms = enclave_terms(session, name, as_recorded=current)
    end = next((each.last for each in terms if each.what == CERTIFICATE), None)
    end = end or _certificate_end(session, name)
    granted = next((each.last for each in terms if is_subject and each.what == PERMISSIONS), None)
    return StatusRow(name, stage, stale, end, granted, problem, terms)


def _in_words(problems: Sequence[Diagnostic]) -> str:
    """Return the first of some problems on one line, with its code; empty if there are none."""
    return f"{problems[0]} [{problems[0].code}]" if problems else ""


def _differing(session: Session, policy: LoadedPolicy | None, names: Sequence[str]) -> Mapping[str, str]:
    """Return the packages that differ from the policy, each with a problem or an empty text."""
    if policy is None:
        return {}
    try:
        found = create.stale(session, policy, names)
    except KeymintError as error:
        return dict.fromkeys(names, _in_words(error.diagnostics))
    return {name: _in_words(errors) for name, errors in found.items()}


# -- renewal --------------------------------------------------------------------------------------------------------


def renewable_packages(
    session: Session, names: Iterable[str], *, rekey: bool
) -> tuple[list[str], State, list[Diagnostic], list[Diagnostic]]:
    """Return which of some packages can be renewed.

    Args:
        session: the workspace and its profile.
        names: packages.
        rekey: they are to get new keys.

    Returns:
        The packages to renew; the record, with the builds of these packages that it did not have; a finding for each
        package whose new key must be made elsewhere; and why other packages cannot be renewed.
    """
    taken: list[str] = []
    requests: list[Diagnostic] = []
    defects = Defects()
    stamps: dict[str, Stamp] = {}
    there = frozenset(enclave_names(session))
    for name in names:
        with defects:
            if rekey and session.issuance(name).public_key:
                message = f"the private key of {subject_of(name)} is not here, so a new one must be made where it is"
                help_ = "run 'keymint request' there, then 'keymint sign' here"
                where = session.issuance_place(name)
                requests.append(Diagnostic.warning("request-needed", message, where, help_, subject_of(name)))
                continue
            _require_certified(session, name, there, rekey=rekey)
            stamps |= _require_same(session, name)
            taken.append(name)
    state = session.state.updated(build.STAGE, stamps) if stamps else session.state
    return taken, state, requests, defects.found


def _require_certified(session: Session, name: str, there: Collection[str], *, rekey: bool) -> None:
    """Require that a package has a certificate that may be followed by another one.

    Raises:
        KeymintError: it is not installed, or its key is barred and no new one was asked for.
    """
    if reason := register_of(session).withdrawn(name):
        if not rekey:
            message = f"the certificate of {subject_of(name)} was revoked ({reason}); no other is issued for its key"
            help_ = f"'keymint renew --rekey {name}' makes a new key"
            raise KeymintError(message, where=session.issuance_place(name), help=help_, code="key-barred")
    elif name not in there and not (rekey and register_of(session).of(name)):  # an enclave that was lost gets a new key
        raise KeymintError.of([missing_enclave(session, session.package(name))])


def _require_same(session: Session, name: str) -> Mapping[str, Stamp]:
    """Require that a renewal changes dates and keys only; returns the record of a build that had none.

    Raises:
        KeymintError: the sources changed since the documents were built, so that others would be built now.
    """
    if is_build_current(session, name) or not is_built(session, name):
        return {}
    planned = build.BuildStage(session, InstallRequest(build=BuildOptions())).package(name)
    require_none(planned.errors)
    folder = session.workspace.build / name
    changes = [each for each in planned.step.changes if each.folder == folder] if planned.step else []
    if any(each.removed or each.files for each in changes):  # it gets other documents than it has
        raise KeymintError(
            f"the sources of {subject_of(name)} changed since its documents were built, and a renewal changes "
            "nothing but dates",
            where=session.workspace.origin(session.workspace.src / name),
            help=f"run 'keymint build {name}' and 'keymint install {name}' first",
            code="sources-changed",
        )
    stamp, step = planned.stamp, planned.step
    return {name: stamp_of(stamp)} if stamp and step and not step.writes() else {}


def refuse_new_authorities(session: Session, plan: Plan) -> None:
    """Refuse a plan that changes an authority: none is renewed on the way.

    Raises:
        KeymintError: it does, since the profile asks for another certificate than the authority has.
    """
    for step in plan.steps:
        if step.stage == authorities.STAGE and step.writes():
            raise KeymintError(
                f"the profile asks for another certificate than the authority {step.package!r} has, and a renewal of "
                "enclaves changes no authority",
                where=session.workspace.origin(session.workspace.authority_certificate(step.package)),
                help=f"run 'keymint authority renew {step.package}' first",
                code="authority-changed",
            )


def packages_of(session: Session, diagnostics: Sequence[Diagnostic], names: Collection[str]) -> frozenset[str]:
    """Return those of some packages that diagnostics are about: by their subject, or by the place in a space."""
    workspace = session.workspace
    spaces = [f"{workspace.shown(space)}/" for space in (workspace.src, workspace.build, session.enclaves)]
    found = {name_of(each.subject) for each in diagnostics if each.subject}
    for each in diagnostics:
        for space in spaces:
            if each.where is not None and each.where.file.startswith(space):
                inside = each.where.file.removeprefix(space)
                found |= {name for name in names if inside == name or inside.startswith(f"{name}/")}
    return frozenset(found & {*names})
