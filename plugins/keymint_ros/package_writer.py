# SPDX-License-Identifier: Apache-2.0
"""Creates source packages from the rules of a subject."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

from comarmor.errors import Diagnostic, Origin
from keymint.api import Role, WorkspaceProfile
from keymint.api.source_documents import Reader
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.names import name_of
from keymint_ros import bootstrap, manifest, permissions, permissions_of_2018, validity
from keymint_ros.manifest import MARKER
from keymint_ros.permissions import WrittenGrant
from keymint_ros.profile_reader import base_of

FORMER = ".2018"
"""Suffix of the backup of a ``permissions.xml`` in the format of 2018 that a new one replaces."""


def create(
    profile: WorkspaceProfile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
) -> Mapping[str, bytes]:
    """Return the files to write for a package: see :meth:`keymint.api.PackageType.create`."""
    name = name_of(rules.subject)
    path = _permissions_path(existing, name)
    return {**_new(profile.build_types, existing), **_permissions(profile, rules, path, existing, force=force)}


def former_rules(rules: SubjectRules, files: Mapping[str, bytes]) -> Sequence[Diagnostic]:
    """Return what permissions of 2018 say differently: see :meth:`keymint.api.FormerRules.former_rules`."""
    name = name_of(rules.subject)
    try:
        path = _permissions_path(files, name)
        permissions.read(files.get(path, b""), f"{name}/{path}", rules.subject)
    except KeymintError as error:
        if error.diagnostics[0].code == permissions.OLD_FORMAT:
            return permissions_of_2018.differences(files[path], f"{name}/{path}", rules)
    return ()


def _permissions_path(files: Mapping[str, bytes], name: str) -> str:
    """Return the path of the permissions in a package, as its manifest gives it."""
    if MARKER not in files:
        return "permissions.xml"
    return manifest.path_of("permissions", name, files)


def create_infrastructure(
    profile: WorkspaceProfile, name: str, build_type: str, existing: Mapping[str, bytes]
) -> Mapping[str, bytes]:
    """Return the files to write: see :meth:`keymint.api.PackageType.create_infrastructure`."""
    del profile, name
    return _new((build_type,), existing, Role.INFRASTRUCTURE)


def _new(build_types: tuple[str, ...], existing: Mapping[str, bytes], role: Role = Role.SUBJECT) -> Mapping[str, bytes]:
    """Return the files of a new package, except those that exist; none if it is a package already."""
    if MARKER in existing:
        return {}
    return {file: content for file, content in bootstrap.package(build_types, role).items() if file not in existing}


def _permissions(
    profile: WorkspaceProfile, rules: SubjectRules, path: str, existing: Mapping[str, bytes], *, force: bool
) -> Mapping[str, bytes]:
    """Return the permissions document if it must be written.

    Like dpkg for configuration files, this compares three states of the rules: those of the policy when the document
    was written, those in the document, and those of the policy now.
    """
    base = base_of(profile)
    new = permissions.render(rules, base)
    current = existing.get(path)
    if current is None:
        return {path: new}
    if current == new:
        return {}
    file = f"{name_of(rules.subject)}/{path}"
    try:
        grant = permissions.read(current, file, rules.subject)
    except KeymintError as error:
        old = error.diagnostics[0].code == permissions.OLD_FORMAT
        if not old and not force:
            raise
        former = {path + FORMER: current} if old and path + FORMER not in existing else {}
        return {**former, path: new}  # the backup first, so that a killed run loses nothing
    if not force and (permissions.has_rules(grant, rules) or _keeps_edit(grant, permissions.digest(rules.rules), file)):
        return {}
    if grant.name == rules.subject and not grant.overrides:
        return {path: new}
    return {path: permissions.render(rules, base, name=grant.name, overrides=grant.overrides)}


def _keeps_edit(grant: WrittenGrant, now: str, file: str) -> bool:
    """Tell whether a document was edited by hand and is kept, since the policy's rules (digest ``now``) did not change.

    Raises:
        KeymintError: the document was edited, and the policy changed too, to other rules than the edit's.
    """
    if not grant.edited or grant.current == now:
        return False
    if grant.base == now:
        return True
    raise KeymintError(
        "these permissions were edited by hand, and the policy changed too",
        where=Origin(file, grant.own.line),
        help="move the edits into the policy, then replace the file with --force",
        code="hand-edited",
    )


_EMPTY = b"    <identity/>\n"
_read_identity_length = Reader("keymint_ros", "identities", validity.length)
_read_grant_length = Reader("keymint_ros", "permissions", validity.length)


def with_validity(
    profile: WorkspaceProfile, rules: SubjectRules, files: Mapping[str, bytes], valid_for: str, now: datetime
) -> Mapping[str, bytes]:
    """Return the files that change: see :meth:`keymint.api.OwnValidity.with_validity`."""
    name = name_of(rules.subject)
    begin = validity.begin_of_period(valid_for, now)
    element = f"<validity><not_before>{begin}</not_before><duration>{valid_for}</duration></validity>"
    path = manifest.path_of("identities", name, files)
    changed: dict[str, bytes] = {}
    if path not in files or _read_identity_length(files[path], f"{name}/{path}") != valid_for:
        new = bootstrap.package_document("identities.xml")
        if files.get(path, new) != new:
            raise _has_own(name, path, valid_for)
        identity = f"    <identity>\n      <cert>{element}</cert>\n    </identity>\n".encode()
        changed[path] = new.replace(_EMPTY, identity)
    if bootstrap.has_grant_validity(manifest.read(files[MARKER], f"{name}/{MARKER}").build_types):
        path = manifest.path_of("permissions", name, files)
        if _read_grant_length(files[path], f"{name}/{path}") != valid_for:
            base = base_of(profile)
            if files[path] != permissions.render(rules, base):
                raise _has_own(name, path, valid_for)
            changed[path] = permissions.render(rules, base, overrides=(element,))
    return changed


def _has_own(name: str, path: str, duration: str) -> KeymintError:
    return KeymintError(
        "was edited by hand, so no validity is written into it",
        where=Origin(f"{name}/{path}"),
        help=f"write <validity> with <duration>{duration}</duration> into it",
        code="hand-edited",
    )
