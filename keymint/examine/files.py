# SPDX-License-Identifier: Apache-2.0
"""Judge what lies on the disk: modes, owners, links, kinds and records of files, and the install space as a whole.

Whoever can write to a folder can replace its files, whatever their modes. Whoever can write to the profile or the
sources decides what every robot may do.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
from functools import lru_cache
from pathlib import Path

from comarmor.values import replace
from keymint.api import Artifact, BuildOptions, Inspection, Package
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.life.workspace_register import withdrawn
from keymint.names import ROOT
from keymint.pki import keys
from keymint.stages import environment_scripts
from keymint.stages.documents import build_shared, enclaves_of, installed_shared
from keymint.stages.trust_anchors import shared_anchors
from keymint.store.changes import file_mode
from keymint.view.file_reading import FileStatus
from keymint.view.stamps import digest
from keymint.workspace import installed_enclaves
from keymint.workspace.installed_enclaves import INSTALLED, KEY, copies_of, enclave_names, files_in, is_script
from keymint.workspace.package_build_types import load_packages, record_key, users
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import GITIGNORE

_GROUP, _OTHERS = stat.S_IWGRP, stat.S_IWOTH
_PEM = ".pem"
CHANGED = "was changed after it was installed"


_Entry = tuple[str, FileStatus]
"""The path of a file or folder of a space, and its status (of a link: of the link itself)."""


def file_status(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield the findings on modes, owners, links and kinds of files in all spaces."""
    workspace = inputs.workspace
    root = inputs.tree.status(workspace.root)
    # Those who may own files: the owner of the workspace, the current user, and root.
    owners = frozenset({0, os.geteuid()} | ({root.st_uid} if root else set()))
    if root is not None:
        yield from _open_to_others(inputs, [(str(workspace.root), root)])
    private = list(_walk(inputs, workspace.private))
    for entries in (private, *(list(_walk(inputs, each)) for each in (workspace.install, workspace.next_install))):
        yield from _kinds(inputs, entries)
        yield from _owned_by_others(inputs, entries, owners)
    yield from _private(inputs, private)
    for space in (workspace.build, workspace.public, workspace.state, workspace.profile, workspace.src):
        entries = [(path, status) for path, status in _walk(inputs, space) if not stat.S_ISLNK(status.st_mode)]
        yield from _open_to_others(inputs, entries)
        yield from _owned_by_others(inputs, entries, owners)


def modes(inputs: Inputs, path: Path | str, mode: int, subject: str) -> Iterator[Diagnostic]:
    """Yield a finding for a symbolic link or an unexpected mode; none if the file does not exist."""
    status = inputs.tree.status(path)
    if status is None:
        return
    if stat.S_ISLNK(status.st_mode):
        yield link(inputs, path, subject)
    elif (existing := stat.S_IMODE(status.st_mode)) != mode:
        shown = inputs.workspace.shown(path)
        yield Diagnostic(
            "file-mode",
            Severity.ERROR if existing & ~mode & 0o077 else Severity.WARNING,
            f"has mode {existing:04o}, expected {mode:04o}",
            Origin(shown),
            f"chmod {mode:o} {shown}",
            subject,
        )


def as_installed(
    inputs: Inputs, path: Path | str, value: str, help_: str, message: str = CHANGED, *, secret: bool = False
) -> Iterator[Diagnostic]:
    """Yield a finding for a file outside of the enclaves that is missing, has another mode, or was changed.

    Args:
        inputs: the workspace.
        path: the file.
        value: digest of what was installed; empty if that is not known.
        help_: what restores it.
        message: what is wrong with one that was changed.
        secret: it is for its owner only.
    """
    if inputs.tree.status(path) is None:
        yield Diagnostic.error("file-missing", "is missing", inputs.workspace.origin(path), help_)
        return
    yield from modes(inputs, path, file_mode(secret=secret), "")
    if value and inputs.tree.has_file(path) and digest(inputs.tree.try_read(path) or b"") != value:
        yield changed_file(inputs, path, help_, message=message)


def changed_file(inputs: Inputs, path: Path | str, help_: str, subject: str = "", message: str = CHANGED) -> Diagnostic:
    """Return the finding on a file that is not what was installed."""
    return Diagnostic.error("file-changed", message, inputs.workspace.origin(path), help_, subject)


def unrecorded_note(what: str, subject: str = "") -> Diagnostic:
    """Return the note that nothing tells what was installed, so that a change is not seen."""
    message, help_ = f"there is no record of {what}", "'keymint install' makes one"
    return Diagnostic.note("record-missing", message, None, help_, subject)


def unexpected_file(inputs: Inputs, path: Path | str, message: str, subject: str = "") -> Diagnostic:
    """Return the finding on a file that belongs to nothing."""
    return Diagnostic.warning("file-unexpected", message, inputs.workspace.origin(path), "remove it", subject)


def link(inputs: Inputs, path: Path | str, subject: str) -> Diagnostic:
    """Return the finding on a symbolic link."""
    message, where = "is a symbolic link, which breaks when the enclave is copied", inputs.workspace.origin(path)
    return Diagnostic.error("file-link", message, where, "remove it and run 'keymint install'", subject)


def linked_twice(inputs: Inputs, path: Path | str, subject: str) -> Iterator[Diagnostic]:
    """Yield a finding for a private key that has a second name (a hard link) somewhere."""
    status = inputs.tree.status(path)
    # An interrupted run kept the keys of what it was about to replace: that run is a finding.
    if status and stat.S_ISREG(status.st_mode) and status.st_nlink > 1 and not inputs.tree.remnants:
        message = f"is a private key with {status.st_nlink} names: another one leads to it from elsewhere"
        help_ = f"find the others with 'find / -xdev -inum {status.st_ino}', and remove them"
        yield Diagnostic.error("key-linked", message, inputs.workspace.origin(path), help_, subject)


def enclave_files_on_disk(session: Session, package: Package, files: Mapping[str, bytes]) -> Iterator[Diagnostic]:
    """Yield the findings on modes, links and recorded digests of the enclave of a package, given its files by name."""
    name, subject, folder = package.name, package.subject, session.enclave_folder(package.name)
    stamp = session.state.stamp(INSTALLED, name)
    secret = stamp.secret if stamp else (KEY,)
    yield from modes(session, folder, 0o700, subject)
    for file in files_in(session, name):
        path = f"{folder}/{file}"
        is_secret = file in secret or keys.has_private_key(files.get(file, b""))
        is_other = stamp is not None and file not in stamp.outputs
        for each in modes(session, path, file_mode(secret=is_secret), subject):
            if not is_other or each.code != "file-mode" or each.severity is Severity.ERROR:  # hidden ones may stay so
                yield each
        if session.tree.follows(path):  # within the keystore: a tool that made the enclave may have meant it
            found = link(session, path, subject)
            help_ = f"copy what it leads to as well ('cp -L', 'rsync -L'), or {found.help}"
            yield replace(found, severity=Severity.NOTE, help=help_) if package.kept else found
        if file in secret:
            yield from linked_twice(session, path, subject)
    if stamp is None:
        yield unrecorded_note(f"what was installed as {subject}", subject)
        return
    for file, value in stamp.outputs.items():
        if file in files and session.tree.digest(f"{folder}/{file}") != value:
            yield changed_file(session, f"{folder}/{file}", f"'keymint install {name}' restores it", subject)


def _private(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Check modes and links of all private keys and their folders."""
    for path, status in entries:
        if stat.S_ISDIR(status.st_mode) or stat.S_ISLNK(status.st_mode):
            yield from modes(inputs, path, 0o700, "")
        elif path.endswith(_PEM):
            found = [*modes(inputs, path, 0o600, ""), *linked_twice(inputs, path, "")]
            if found and not keys.is_all_public(inputs.tree.try_read(path) or b""):
                yield from found


def _kinds(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Report entries of a space created by Keymint that are neither files nor folders, and folders open to others.

    Links are reported with the modes.
    """
    for path, status in entries:
        kind = stat.S_IFMT(status.st_mode)
        if kind not in (stat.S_IFREG, stat.S_IFDIR, stat.S_IFLNK):
            is_a = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket"}.get(kind, "a device")
            message, where = f"is {is_a}, where files and folders are expected", inputs.workspace.origin(path)
            yield Diagnostic.error("file-kind", message, where, "remove it")
    for path, status in entries:
        mode = status.st_mode
        if stat.S_ISDIR(mode) and mode & (_GROUP | _OTHERS):
            shown = inputs.workspace.shown(path)
            message = f"has mode {stat.S_IMODE(mode):04o}: others can replace what lies in it"
            yield Diagnostic.error("place-writable", message, Origin(shown), f"chmod go-w {shown}")


def _open_to_others(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Yield one finding for all files and folders of a space that others can write to."""
    writable = [path for path, status in entries if _writable_by_others(status)]
    if writable:
        first = inputs.workspace.shown(writable[0])
        more = f", and {len(writable) - 1} more below it or beside it" if len(writable) > 1 else ""
        message = f"others can write this{more}, and with it decide what the robots may do"
        help_ = f"chmod -R go-w {inputs.workspace.shown(entries[0][0])}" if more else f"chmod go-w {first}"
        yield Diagnostic.warning("place-writable", message, Origin(first), help_)


def _owned_by_others(inputs: Inputs, entries: list[_Entry], owners: frozenset[int]) -> Iterator[Diagnostic]:
    """Yield one finding for all files and folders of a space that belong to others, and one for each such key."""
    foreign = [(path, status.st_uid) for path, status in entries if status.st_uid not in owners]
    keys = [(path, owner) for path, owner in foreign if path.endswith(_PEM)]
    for path, owner in keys or foreign[:1]:
        shown = inputs.workspace.shown(path)
        more = "" if keys or len(foreign) == 1 else f", like {len(foreign) - 1} more below it or beside it"
        message = f"belongs to {_user(owner)}, who can change it{more}"
        help_ = f"chown {_user(min(owners - {0}, default=0))} {shown}"
        yield Diagnostic.error("file-owner", message, Origin(shown), help_)


def _walk(inputs: Inputs, folder: Path) -> Iterator[_Entry]:
    """Yield a folder and everything below it; unreadable folders are reported where their content is checked."""
    status = inputs.tree.status(folder)
    if status is None:
        return
    yield str(folder), status
    for path, _ in inputs.tree.walk(folder) if stat.S_ISDIR(status.st_mode) else ():
        if (status := inputs.tree.status(path)) is not None:
            yield path, status


def _writable_by_others(status: FileStatus) -> bool:
    mode = status.st_mode
    return bool(mode & _OTHERS) or (bool(mode & _GROUP) and not _is_own_group(status.st_uid, status.st_gid))


@lru_cache(maxsize=256)
def _is_own_group(user: int, group: int) -> bool:
    """Tell whether a group is a user's private group (login.defs: USERGROUPS_ENAB)."""
    try:
        name, entry = pwd.getpwuid(user).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return entry.gr_name == name and set(entry.gr_mem) <= {name}


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"


_OTHER_COPY = "differs from the enclaves' content"
_OTHER_SCRIPT = "differs from what Keymint writes, and shells that source it may use another keystore"


def outside_enclaves(session: Session, within: timedelta) -> Iterator[Diagnostic]:
    """Yield the findings on the install space outside the enclaves.

    Args:
        session: the workspace and its profile.
        within: report what expires within this time.
    """
    found, known = _shared(session, within)
    yield from found
    workspace, names = session.workspace, enclave_names(session)
    enclaves = {session.enclave_folder(name) for name in names if name != ROOT}
    own = {f"{session.enclave_folder(ROOT)}/{file}" for file in files_in(session, ROOT)} if ROOT in names else ()
    entries = list(session.tree.walk(workspace.install, skipped=""))
    files = [path for path, is_folder in entries if not is_folder]
    outside = [path for path in files if path.rpartition("/")[0] not in enclaves]
    expected = _copies(session, names, outside)
    revoked = () if names else tuple(withdrawn(session))
    own_scripts = environment_scripts.scripts(
        session, session.profile.build_types if revoked else installed_enclaves.build_types_in_use(session)
    )
    targets = set(map(session.tree.follows, files))
    again = f"'keymint renew --rekey {revoked[0]}' restores it" if revoked else "the next enclave brings it back"
    restores = "'keymint install' restores it" if names else again
    # An error if one cannot be read, before anything is told.
    empty = [path for path, is_folder in entries if is_folder and not session.tree.names(path)]
    for relative, content in expected.items():
        if (path := f"{workspace.install}/{relative}") not in own and path not in targets:
            yield from as_installed(session, path, digest(content), restores, _OTHER_COPY)
    for path in outside:
        relative = path.removeprefix(f"{workspace.install}/")
        if path in own or path in targets or relative in known or relative in expected or relative == GITIGNORE:
            continue
        if relative in own_scripts:  # a workspace that was not installed since they exist has none
            is_ours = is_script(session.tree.try_read(path) or b"")
            help_ = restores if is_ours else "rename it or remove it, and run 'keymint install'"
            yield from as_installed(session, path, digest(own_scripts[relative]), help_, _OTHER_SCRIPT)
        else:
            yield unexpected_file(session, path, "is in the install space, but belongs to no enclave")
    for folder in empty:
        message = "is an empty folder in the install space that Keymint did not create"
        yield Diagnostic.warning("folder-unexpected", message, workspace.origin(folder), "remove it")


def _copies(session: Session, names: Sequence[str], outside: Iterable[str]) -> Mapping[str, bytes]:
    """Return the copies of enclaves' files that all installed build types have outside of them, by path.

    If all that have them were revoked, the copies stay for those that get a new key, and are compared with each other.

    Args:
        session: the workspace and its profile.
        names: the installed enclaves.
        outside: paths of the files outside of them.
    """
    sources = frozenset(session.packages())
    gone = frozenset(names) - sources if sources.intersection(names) else frozenset[str]()  # all hidden: they need them
    stamps = {name: session.state.stamp(INSTALLED, name) for name in names}
    altered = {
        name
        for name, stamp in stamps.items()
        if stamp and not installed_enclaves.has_outputs(session, session.enclave_folder(name), stamp)
    }
    gone |= altered if altered < stamps.keys() else frozenset()  # they are reported; what others have in common stays
    found = installed_enclaves.shared_copies(session, installed_enclaves.EnclaveChanges(removed=gone))
    if not any(found) and withdrawn(session):
        left = {"": {path.rpartition("/")[2]: Artifact(session.tree.try_read(path) or b"") for path in outside}}
        build_types = map(session.plugins.build_type, session.plugins.names("keymint.build_types"))
        found = [copies_of(session, each, left) for each in build_types if session.profile.layout in each.LAYOUTS]
    return {path: artifact.content for copies in found for path, artifact in copies.items()}


# -- documents over all packages ------------------------------------------------------------------------------------


def _shared(session: Session, within: timedelta) -> tuple[Iterable[Diagnostic], set[str]]:
    """Return the findings on the installed documents over all packages of a build type, and the paths of these."""
    diagnostics: list[Diagnostic] = []
    files: set[str] = set()
    try:
        of_types = users(session)
    except KeymintError as error:
        return error.diagnostics, files
    for name in of_types:
        stamp = session.state.stamp(INSTALLED, record_key(name))
        recorded: Mapping[str, str] = stamp.outputs if stamp else {}
        try:
            inspection = _inspection(session, name, recorded, within)
        except KeymintError as error:
            diagnostics += error.diagnostics
            files |= recorded.keys()
            continue
        files |= inspection.files.keys()
        for path in sorted({*inspection.documents, *recorded, *inspection.files}):
            secret = stamp is not None and path in stamp.secret
            value, help_ = recorded.get(path, ""), "'keymint build' and 'keymint install' write it"
            diagnostics += as_installed(session, session.workspace.install / path, value, help_, secret=secret)
        if stamp is None and inspection.files:
            diagnostics.append(unrecorded_note(f"the installed shared documents of {name}"))
        diagnostics += session.plugins.build_type(name).check_shared(inspection)
    return dict.fromkeys(diagnostics), files


def _inspection(session: Session, name: str, recorded: Iterable[str], within: timedelta) -> Inspection:
    packages = load_packages(session, name)
    # What the options of a build accept was reported and accepted when the documents were built.
    built = build_shared(session, name, BuildOptions(allow_vendor_specific=True))
    anchors = shared_anchors(session, packages, session.plugins.build_type(name))
    return Inspection(
        packages=packages,
        documents=built.documents,
        files=installed_shared(session, sorted({*built.documents, *recorded})),
        enclaves=enclaves_of(session, name),
        folder=session.workspace.shown(session.workspace.install),
        layout=session.profile.layout,
        chains={role: anchor.chain for role, anchor in anchors.items()},
        now=session.now,
        within_days=within / timedelta(days=1),
    )
