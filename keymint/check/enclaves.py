# SPDX-License-Identifier: Apache-2.0
"""Check one installed enclave: its key, its files on the disk, and the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import timedelta

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import BuildOptions, Inspection, Package
from keymint.changes import file_mode
from keymint.check.file_status import linked_twice, modes
from keymint.errors import KeymintError
from keymint.pki import keys
from keymint.plan import identity_keys, install
from keymint.plan.authority_files import trusted_chains
from keymint.plan.enclaves import enclave_files
from keymint.plan.private_keys import key_defects
from keymint.session import Inputs, Session
from keymint.state import digest


def inspection(session: Session, package: Package, within: timedelta) -> tuple[Inspection, tuple[Diagnostic, ...]]:
    """Return what a build type needs to check the enclave of a package, and a finding for each unreadable file."""
    chains = trusted_chains(session)
    # Differences between vendors were reported and accepted when the package was built.
    built = session.plugins.build_type(package.build_type, session.package_marker(package.name)).build(
        package, BuildOptions(allow_vendor_specific=True)
    )
    files, unread = enclave_files(session, package.name)
    seen = Inspection(
        package=package,
        documents=built.documents,
        files=files,
        folder=session.workspace.shown(session.enclaves / package.name),
        layout=session.profile.layout,
        identity_ca=chains.get(package.identity.issuer, b""),
        permissions_ca=chains.get(package.grant.issuer, b""),
        now=session.now,
        within_days=within / timedelta(days=1),
    )
    return seen, tuple(each for each in unread if each.code != "symlink-refused")  # reported with the modes


def identity_key(
    inputs: Inputs, package: Package, keyring: identity_keys.Keyring
) -> tuple[str, tuple[Diagnostic, ...]]:
    """Return the fingerprint of a package's private key (empty if it cannot be read), and the findings on it.

    Args:
        inputs: the workspace.
        package: the package.
        keyring: the known keys of all subjects and authorities.
    """
    path, subject = inputs.workspace.identity_key(package.name), f"/{package.name}"
    fingerprint = ""
    try:
        pem = inputs.tree.read(path)
        if pem is None:
            message = f"the private key of {subject} is not here"
            where, help_ = Origin(inputs.workspace.shown(path)), f"'keymint build {package.name}' restores it"
            return "", (Diagnostic("key-missing", Severity.NOTE, message, where, help_, subject),)
        key = identity_keys.load(inputs, package, path, pem).public_key()
        fingerprint = keys.fingerprint(key)
        keyring.require_own(package.name, path, key)
    except KeymintError as error:
        return fingerprint, tuple(key_defects(error, subject))
    return fingerprint, ()


def on_disk(session: Session, name: str, files: Mapping[str, bytes]) -> Iterator[Diagnostic]:
    """Check modes, links and recorded digests of one enclave."""
    folder = session.enclaves / name
    stamp = session.state.stamp(install.STAGE, name)
    secret = stamp.secret if stamp else ("key.pem",)
    yield from modes(session, folder, 0o700, f"/{name}")
    for file, is_folder in session.tree.names(folder):
        if not is_folder:
            yield from modes(session, folder / file, file_mode(secret=file in secret), f"/{name}")
            if file in secret:
                yield from linked_twice(session, folder / file, f"/{name}")
    if stamp is None:
        yield Diagnostic(
            "record-missing",
            Severity.NOTE,
            f"there is no record of what was installed as /{name}",
            None,
            "'keymint install' makes one",
            f"/{name}",
        )
        return
    for file, value in stamp.outputs.items():
        if file in files and digest(files[file]) != value:
            yield Diagnostic(
                "file-changed",
                Severity.ERROR,
                "was changed after it was installed",
                Origin(session.workspace.shown(folder / file)),
                f"'keymint install {name}' restores it",
                f"/{name}",
            )
