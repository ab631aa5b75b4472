# SPDX-License-Identifier: Apache-2.0
"""The installed enclaves: their names, files and certificates."""

from __future__ import annotations

import stat
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from cryptography import x509

from comarmor.errors import Diagnostic, Origin
from keymint.errors import KeymintError
from keymint.names import ROOT, subject_of
from keymint.pki import certificates
from keymint.store.changes import File, file_mode
from keymint.view.stamps import Stamp
from keymint.workspace.session import Inputs, Session, once
from keymint.workspace.workspace import hidden_by

CERTIFICATE, KEY = "cert.pem", "key.pem"
INSTALLED = "install"
"""Key of the record of installed enclaves."""


@once
def enclave_names(session: Session) -> tuple[str, ...]:
    """Return the names of the installed enclaves, sorted."""
    names: list[str] = []
    has_root = session.enclaves != session.workspace.install

    def search(folder: str, name: str) -> None:
        entries = session.tree.names(folder)
        if (name or has_root) and any(entry in {KEY, CERTIFICATE} for entry, is_folder in entries if not is_folder):
            names.append(name or ROOT)
        for entry, is_folder in entries:
            if is_folder and not entry.startswith("."):
                search(f"{folder}/{entry}", f"{name}/{entry}" if name else entry)

    search(str(session.enclaves), "")
    return tuple(sorted(names))


def with_sources(session: Session) -> tuple[str, ...]:
    """Return the names of the installed enclaves that have a source package, sorted."""
    known = frozenset(session.packages())
    return tuple(name for name in enclave_names(session) if name in known)


def orphans(session: Session) -> tuple[str, ...]:
    """Return the installed enclaves without a source package, sorted, except those that KEYMINT_IGNORE hides."""
    return tuple(name for name, marker in unknown_enclaves(session) if marker is None)


def hidden(session: Session) -> tuple[str, ...]:
    """Return the installed enclaves whose source packages a KEYMINT_IGNORE hides, sorted."""
    return tuple(name for name, marker in unknown_enclaves(session) if marker is not None)


def unknown_enclaves(session: Session) -> Iterator[tuple[str, Path | None]]:
    """Yield the installed enclaves without a visible source package, each with the marker that hides the package."""
    src, known = session.workspace.src, set(session.packages())
    for name in enclave_names(session):
        if name not in known:
            yield name, hidden_by(session.tree, src, name)


def require_sources(inputs: Inputs) -> None:
    """Require a source space; without one every enclave would count as orphaned.

    Raises:
        KeymintError: there is none.
    """
    src = inputs.workspace.src
    if inputs.tree.status(src) is None and not inputs.tree.names(src):
        raise KeymintError(
            "there is no source space, so it is unknown which enclaves are orphaned",
            where=inputs.workspace.origin(src),
            help="set it with --src-space, or create it to remove all enclaves",
            code="sources-missing",
        )


def files_in(session: Session, name: str) -> tuple[str, ...]:
    """Return the names of the files of an enclave, sorted.

    The folder of the root enclave has those that all enclaves share as well: there, a file is the enclave's if a build
    type has one of that name, and a certificate or a key shows that there is an enclave.

    Raises:
        KeymintError: the folder cannot be read.
    """
    found = tuple(file for file, is_folder in session.tree.names(session.enclave_folder(name)) if not is_folder)
    if name != ROOT:
        return found
    if KEY not in found and CERTIFICATE not in found:
        return ()
    return tuple(file for file in found if file in _known_names(session))


@once
def _known_names(session: Session) -> frozenset[str]:
    """Return the names of the files that any installed build type puts into enclaves."""
    build_types = map(session.plugins.build_type, session.plugins.names("keymint.build_types"))
    return frozenset(file for each in build_types for file in each.files(session.profile.layout))


@once
def enclave_files(session: Session, name: str) -> tuple[Mapping[str, bytes], tuple[Diagnostic, ...]]:
    """Return the files of a package's enclave by name, and a finding for each that cannot be read."""
    files: dict[str, bytes] = {}
    unreadable: list[Diagnostic] = []
    folder = session.enclave_folder(name)
    try:
        entries = files_in(session, name)
    except KeymintError as error:
        return {}, tuple(replace(each, subject=subject_of(name)) for each in error.diagnostics)
    for file in entries:
        path = f"{folder}/{file}"
        try:
            content = session.tree.read(path)
        except KeymintError as error:
            where = session.workspace.origin(path)
            unreadable += (
                replace(each, where=where, help=each.help or "remove it", subject=subject_of(name))
                for each in error.diagnostics
            )
            continue
        if content is not None:
            files[file] = content
    return files, tuple(unreadable)


def enclave_digests(session: Session, name: str) -> dict[str, str] | None:
    """Return the digests of :func:`enclave_files`; None if a file cannot be read."""
    folder = session.enclave_folder(name)
    try:
        found = {file: session.tree.digest(f"{folder}/{file}") for file in files_in(session, name)}
    except KeymintError:
        return None
    return {file: value for file, value in found.items() if value is not None}


def not_installed(name: str, folder: str) -> Diagnostic:
    """Return the finding on a package without an enclave; the folder is the missing one as messages show it."""
    message, help_ = f"the enclave {subject_of(name)} is not installed", f"run 'keymint install {name}'"
    return Diagnostic.error("enclave-missing", message, Origin(folder), help_, subject_of(name))


@once
def deployed_authorities(session: Session) -> tuple[x509.Certificate, ...]:
    """Return the certificates of authorities that the installed enclaves trust, each once.

    Files that cannot be read or contain no certificates are skipped.
    """
    contents: dict[bytes, None] = {}
    for name in enclave_names(session):
        for entry, is_folder in session.tree.names(session.enclave(name)):
            if not is_folder and entry.endswith(".pem") and entry not in {CERTIFICATE, KEY}:
                contents[session.tree.try_read(session.enclave(name) / entry) or b""] = None
    return tuple(dict.fromkeys(certificate for pem in contents for certificate in _certificates(pem)))


def installed_certificate(session: Session, name: str) -> x509.Certificate | None:
    """Return the identity certificate of an installed enclave, or None if there is no readable one."""
    pem = session.tree.try_read(f"{session.enclave_folder(name)}/{CERTIFICATE}")
    return next(_certificates(pem or b""), None)


def _certificates(pem: bytes) -> Iterator[x509.Certificate]:
    try:
        for certificate in certificates.load_bundle(pem) if pem else ():
            certificates.public_key(certificate)
            yield certificate
    except KeymintError:
        return


def has_mode(inputs: Inputs, path: Path | str, *, secret: bool) -> bool:
    """Tell whether an installed file has its mode, or does not exist."""
    status = inputs.tree.status(path)
    return status is None or stat.S_IMODE(status.st_mode) & 0o777 == file_mode(secret=secret)


def new_files(
    inputs: Inputs, folder: Path, existing: Mapping[str, bytes], files: Mapping[str, File]
) -> dict[str, File]:
    """Return the files that a folder does not have yet, with their content and their mode."""
    return {
        path: file
        for path, file in files.items()
        if existing.get(path) != file.content or not has_mode(inputs, folder / path, secret=file.secret)
    }


def has_outputs(inputs: Inputs, folder: str, stamp: Stamp) -> bool:
    """Tell whether the files of a stamp in a folder are as they were installed; none is if it cannot be read."""
    try:
        return all(
            inputs.tree.digest(f"{folder}/{file}") == value
            and has_mode(inputs, f"{folder}/{file}", secret=file in stamp.secret)
            for file, value in stamp.outputs.items()
        )
    except KeymintError:
        return False
