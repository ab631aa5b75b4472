# SPDX-License-Identifier: Apache-2.0
"""Compare the installed keystore with its expected state: ``keymint check``.

The build type checks the content of an enclave. This module checks the workspace, with those beside it: the key of each
enclave, its files on the disk, the record of installed files, unexpected files, authorities, and the files that all
enclaves share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
from functools import partial
from itertools import chain
from typing import Any, TypeVar

from comarmor.values import Data, field, replace
from keymint.api import BuildOptions, BuildType, Inspection, Package
from keymint.authority.authority_files import elsewhere, trusted_chains
from keymint.authority.examine import DECIDED_BY_A_PERSON
from keymint.errors import Diagnostic, KeymintError, Severity
from keymint.examine import keystore
from keymint.examine.authorities import authorities, encryption, exposed_keys, git_exposure
from keymint.examine.files import enclave_files_on_disk, file_status, outside_enclaves, unexpected_file
from keymint.host.pool import Pool
from keymint.life.examine import Keyring, orphan_findings, shared_keys
from keymint.names import subject_of
from keymint.pki import keys
from keymint.stages import identities
from keymint.stages.documents import built_documents
from keymint.stages.trust_anchors import unvouched_files
from keymint.view.stamps import digest
from keymint.workspace import installed_enclaves
from keymint.workspace.package_build_types import BUILD, build_types_of, is_build_current
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import key_defects

Inspections = Mapping[str, tuple[BuildType, Inspection]]
"""What each build type of a package sees of its enclave."""


class LoadedEnclave(Data):
    """A package, and the files of its enclave.

    Attributes:
        package: the package; None if it has defects.
        files: the files by name.
        unread: findings on files that cannot be read, or the defects of the package.
        seen: what each build type sees of it.
    """

    package: Package | None
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    unread: tuple[Diagnostic, ...] = ()
    seen: Inspections = field(default_factory=dict)

    @property
    def is_absent(self) -> bool:
        """Whether there is no enclave."""
        return not self.files and not self.unread


def load(session: Session, name: str, within: timedelta) -> LoadedEnclave:
    """Load a package and its enclave.

    Args:
        session: the workspace and its profile.
        name: the package.
        within: report what expires within this time.
    """
    try:
        package = session.package(name, built=is_build_current(session, name))
        files, unreadable = installed_enclaves.enclave_files(session, name)
        unread = tuple(each for each in unreadable if each.code != "symlink-refused")  # reported with the modes
        return LoadedEnclave(package, files, unread, _inspections(session, package, files, within))
    except KeymintError as error:
        return LoadedEnclave(None, unread=tuple(error.diagnostics))


def examine(session: Session, loaded: LoadedEnclave, keyring: Keyring) -> tuple[str, str, tuple[Diagnostic, ...]]:
    """Check one enclave, and what of it the authorities of the workspace do not vouch for.

    Args:
        session: the workspace and its profile.
        loaded: the enclave.
        keyring: the known keys of all subjects and authorities.

    Returns:
        The package, the fingerprint of its key (empty if it cannot be read), and the findings.
    """
    package = loaded.package
    if package is None:
        return "", "", loaded.unread
    fingerprint, findings = _identity_key(session, package, keyring)
    found = (*findings, *_of_files(session, package, loaded))
    known = {(each.code, each.where) for each in found}
    try:
        more = dict.fromkeys(unvouched_files(session, package))
        foreign = tuple(each for each in more if (each.code, each.where) not in known)
    except KeymintError:  # of documents of several packages, which are reported
        foreign = ()
    all_found = (*found, *foreign)
    if lost := next((each for each in findings if each.code == "key-missing"), None):  # nothing else gives it back
        place = session.workspace.origin(session.enclave(package.name) / installed_enclaves.KEY)
        all_found = tuple(
            replace(each, help=lost.help) if each.where == place and each.code in _OF_KEY else each
            for each in all_found
        )
    return package.name, fingerprint, all_found


_OF_KEY = frozenset({"file-missing", "file-changed", "key-mismatch"})
"""Codes of findings on the private key in an enclave that its copy in the workspace mends."""


def _of_files(session: Session, package: Package, loaded: LoadedEnclave) -> Iterator[Diagnostic]:
    """Yield the findings on the files of an enclave, and those of its build types; or that on a missing enclave."""
    name, subject = package.name, package.subject
    if loaded.is_absent:
        yield identities.missing_enclave(session, package)
        return
    yield from loaded.unread
    yield from enclave_files_on_disk(session, package, loaded.files)
    known = frozenset[str]().union(*(own.files for _, own in loaded.seen.values()))
    for file in sorted(loaded.files.keys() - known):
        message = f"does not belong to the layout {session.profile.layout!r}"
        yield unexpected_file(session, session.enclave(name) / file, message, subject)
    unread = {each.where for each in loaded.unread}
    key = f"{session.enclave_folder(name)}/{installed_enclaves.KEY}"
    if session.tree.is_left_out(key):
        unread.add(session.workspace.origin(key))
    for each in dict.fromkeys(each for build_type, own in loaded.seen.values() for each in build_type.check(own)):
        if each.code != "file-missing" or each.where not in unread:
            yield each


def _inspections(session: Session, package: Package, files: Mapping[str, bytes], within: timedelta) -> Inspections:
    """Return what each build type needs to check the enclave of a package, by its name.

    Raises:
        KeymintError: the package has defects.
    """
    build_types = build_types_of(session, package)
    recorded: Mapping[str, bytes] | None = None
    stamp = session.state.stamp(BUILD, package.name)
    # The record has the digests of what all build types built, and does not say whose each is.
    if len(build_types) == 1 and stamp is not None and is_build_current(session, package.name):
        built = built_documents(session, package.name)
        recorded = built if {file: digest(content) for file, content in built.items()} == stamp.outputs else None
    options = BuildOptions(allow_vendor_specific=True)  # differences were accepted when the package was built
    chains = trusted_chains(session)
    folder, layout = session.workspace.shown(session.enclave_folder(package.name)), session.profile.layout
    found: dict[str, tuple[BuildType, Inspection]] = {}
    for name, build_type in build_types.items():
        own = build_type.files(layout)
        inspection = Inspection(
            packages=(package,),
            documents=build_type.build(package, options).documents if recorded is None else recorded,
            files={file: content for file, content in files.items() if file in own},
            folder=folder,
            layout=layout,
            chains={role.role: chains.get(role.name, b"") for role in build_type.authorities(package)},
            now=session.now,
            within_days=within / timedelta(days=1),
        )
        found[name] = build_type, inspection
    return found


def _identity_key(session: Session, package: Package, keyring: Keyring) -> tuple[str, tuple[Diagnostic, ...]]:
    """Return the fingerprint of a package's key (empty if it cannot be read), and the findings on it.

    Args:
        session: the workspace and its profile.
        package: the package.
        keyring: the known keys of all subjects and authorities.
    """
    path, subject = session.workspace.identity_key(package.name), subject_of(package.name)
    fingerprint = ""
    try:
        pem = session.tree.read(path)
        if session.tree.is_left_out(path) and not package.issuance.public_key:
            return "", ()
        if pem is None and not package.issuance.public_key and not package.identity.key.uri:
            # A copy of a workspace without any private file is there to be checked.
            is_copy = session.tree.status(session.workspace.private) is None
            severity, (found,) = (
                Severity.NOTE if is_copy else Severity.WARNING,
                identities.missing_key(session, package.name).diagnostics,
            )
            return "", (replace(found, severity=severity, subject=subject),)
        key = identities.public_key(session, package)
        fingerprint = keys.fingerprint(key)
        keyring.require_own(package, key)
        if pem is not None and package.issuance.public_key:
            message = f"is a private key of {subject}, whose certificate is for a key elsewhere: nothing uses this one"
            where, help_ = session.workspace.origin(path), "remove it, once no installed enclave uses it"
            return fingerprint, (Diagnostic.warning("key-unused", message, where, help_, subject),)
    except KeymintError as error:
        return fingerprint, tuple(key_defects(error, subject))
    return fingerprint, ()


LEAST = 32
"""Enclaves that are worth a part of their own. One part is worth no process: fewer are examined sooner in this one."""
_Beside = TypeVar("_Beside")


def check(
    session: Session, names: Sequence[str], within: timedelta, pool: Pool, beside: Callable[[], _Beside]
) -> tuple[tuple[Diagnostic, ...], _Beside]:
    """Return all findings on the enclaves of some packages, and on their workspace.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        within: report what expires within this time.
        pool: where to examine many enclaves: processes of this machine, since they read private keys.
        beside: what this process is to do besides; its result comes second.
    """
    of_authorities = tuple(authorities(session, within))
    keyring = Keyring(session)
    loaded = [load(session, name, within) for name in names]
    first = [examine(session, each, keyring) for each in loaded[:1]]  # processes have then what all enclaves need
    parts = pool.parts(loaded[1:], LEAST)
    tasks: list[Callable[[], Iterable[Any]]] = [
        partial(map, lambda each: examine(session, each, keyring), part) for part in parts
    ]
    around = outside_enclaves(session, within), file_status(session), git_exposure(session), _deciding(session)
    tasks.append(lambda: (*map(tuple, around), beside()))  # what is last this process does itself
    pool = pool if len(parts) > 1 else Pool(1)
    *rest, (outside, of_files, of_git, decides, more) = pool.map(lambda task: tuple(task()), tasks)
    enclaves = [*first, *chain.from_iterable(rest)]
    findings = [finding for _, _, of_enclave in enclaves for finding in of_enclave]
    seen = [each.seen for each in loaded if not each.is_absent]
    for build_type in sorted({name for of_enclave in seen for name in of_enclave}):
        inspections = [of_enclave[build_type][1] for of_enclave in seen if build_type in of_enclave]
        findings += session.plugins.build_type(build_type).check_all(inspections)
    findings += orphan_findings(session)
    findings += (each for each in decides if each not in findings)  # the defects of packages are found above
    fingerprints = {name: fingerprint for name, fingerprint, _ in enclaves if fingerprint}
    findings += shared_keys(session, fingerprints)
    findings += (*elsewhere(session), *encryption(session), *exposed_keys(session))
    findings += outside
    told = {(each.code, each.where) for each in of_authorities}  # e.g. that an authority has no certificate
    findings = [each for each in findings if (each.code, each.where) not in told]
    if defect := next((each for each in of_authorities if each.code in DECIDED_BY_A_PERSON), None):
        help_ = f"fix {defect.where} first"  # until then installing fails
        findings = [replace(each, help=help_) if keystore.INSTALLS.search(each.help) else each for each in findings]
    found = (*of_authorities, *of_files, *of_git, *findings, *_of_second_keystore(session, names, within, pool))
    return tuple(
        sorted(found, key=lambda each: each.code != keystore.UNFINISHED)
    ), more  # it may be the cause of others


def _deciding(session: Session) -> Iterator[Diagnostic]:
    try:
        yield from tuple(keystore.deciding_findings(session))
    except KeymintError as error:  # a package has defects, or the register
        yield from error.diagnostics


def _of_second_keystore(
    session: Session, names: Sequence[str], within: timedelta, pool: Pool
) -> tuple[Diagnostic, ...]:
    """Return the findings on a keystore that lies beside the one in force, judged as if it were that one."""
    try:
        ahead = keystore.staged_keystore_session(session)
    except KeymintError as error:
        return error.diagnostics
    if ahead is None:
        return ()
    ready = frozenset(installed_enclaves.with_sources(ahead))
    found, _ = check(ahead, [name for name in names if name in ready], within, pool, tuple)
    return keystore.of_second_keystore(session, (each for each in found if each.code not in _OF_RECORD))


_OF_RECORD = frozenset({"record-missing", "key-missing"})
"""Codes of findings on what nobody records, or has, of a second keystore."""
