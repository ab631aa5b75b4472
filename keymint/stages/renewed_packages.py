# SPDX-License-Identifier: Apache-2.0
"""Which packages a renewal takes up, and which it leaves to a person."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from comarmor.errors import Defects, Diagnostic
from keymint.api import BuildOptions
from keymint.authority import authorities
from keymint.errors import KeymintError
from keymint.life.package_issuance import place_of
from keymint.life.workspace_register import register_of
from keymint.names import name_of, subject_of
from keymint.stages import build
from keymint.stages.documents import is_built
from keymint.store.changes import FolderChange, Plan
from keymint.view.stamps import Stamp, State
from keymint.workspace.installed_enclaves import enclave_names
from keymint.workspace.package_build_types import is_build_current
from keymint.workspace.session import Session


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
                requests.append(_request(session, name))
                continue
            _require_certified(session, name, there, rekey=rekey)
            stamps |= _require_same(session, name)
            taken.append(name)
    state = session.state.updated(build.STAGE, stamps) if stamps else session.state
    return taken, state, requests, defects.found


def _request(session: Session, name: str) -> Diagnostic:
    return Diagnostic.warning(
        "request-needed",
        f"the private key of {subject_of(name)} is not here, so a new one must be made where it is",
        place_of(session, name), "run 'keymint request' there, then 'keymint sign' here", subject_of(name),
    )  # fmt: skip


def _require_certified(session: Session, name: str, there: Collection[str], *, rekey: bool) -> None:
    """Require that a package has a certificate that may be followed by another one.

    Raises:
        KeymintError: it is not installed, or its key is barred and no new one was asked for.
    """
    if reason := register_of(session).withdrawn(name):
        if not rekey:
            raise KeymintError(
                f"the certificate of {subject_of(name)} was revoked ({reason}), and nothing is issued for its key "
                "again",
                where=place_of(session, name),
                help=f"'keymint renew --rekey {name}' makes a new key",
                code="key-barred",
            )
    elif name not in there and not (rekey and register_of(session).of(name)):  # an enclave that was lost gets a new key
        raise KeymintError(
            f"the enclave {subject_of(name)} is not installed, so there is nothing to renew",
            where=session.workspace.origin(session.enclave_folder(name)),
            help=f"run 'keymint build {name}' and 'keymint install {name}'",
            code="enclave-missing",
        )


def _require_same(session: Session, name: str) -> Mapping[str, Stamp]:
    """Require that a renewal changes dates and keys only; returns the record of a build that had none.

    Raises:
        KeymintError: the sources changed since the documents were built, so that others would be built now.
    """
    if is_build_current(session, name) or not is_built(session, name):
        return {}
    planned = build.BuildStage(session, BuildOptions()).package(name)
    if planned.errors:
        raise KeymintError.of(planned.errors)
    if planned.step and any(_is_other(session, name, change) for change in planned.step.changes):
        raise KeymintError(
            f"the sources of {subject_of(name)} changed since its documents were built, and a renewal changes "
            "nothing but dates",
            where=session.workspace.origin(session.workspace.src / name),
            help=f"run 'keymint build {name}' and 'keymint install {name}' first",
            code="sources-changed",
        )
    return {name: planned.stamp} if planned.stamp and planned.step and not planned.step.writes() else {}


def _is_other(session: Session, name: str, change: FolderChange) -> bool:
    """Tell whether a change gives a package other documents than it has."""
    return change.folder == session.workspace.build / name and bool(change.removed or change.files)


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
