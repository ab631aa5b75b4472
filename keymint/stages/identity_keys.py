# SPDX-License-Identifier: Apache-2.0
"""The private key of each subject: minted once, restored from its enclave, and never replaced without a request.

A replaced key would give the subject's permissions to whoever replaced it.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Package
from keymint.authority.authority_files import authority_keys
from keymint.errors import KeymintError
from keymint.life.package_issuance import place_of
from keymint.names import subject_of
from keymint.pki import certificates, keys, public_keys
from keymint.store.changes import FolderChange, secret_file
from keymint.view.stamps import digest
from keymint.workspace.installed_enclaves import INSTALLED, KEY, enclave_names, installed_certificate
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import IDENTITY_KEYS, load_key, recorded_key


def _remedy(name: str) -> str:
    """Return how to fix a key that cannot be used."""
    restored = f"remove it and run 'keymint build {name}' to restore it from the enclave"
    return f"{restored}, or mint a new one with {_new(name)}"


def _new(name: str) -> str:
    return f"'keymint build --renew {name}'"


def key_digest(session: Session, name: str) -> str | None:
    """Return a digest of the key that a package's certificate is issued for; None if the workspace lacks it.

    Raises:
        KeymintError: what the authority decided about the package has defects.
    """
    public = session.issuance(name).public_key
    return digest(public) if public else session.tree.digest(session.workspace.identity_key(name))


def is_there(session: Session, name: str) -> bool:
    """Tell whether the workspace has the key that a package's certificate is issued for, or never will.

    Raises:
        KeymintError: the package has defects.
    """
    if session.issuance(name).public_key or session.tree.has_file(session.workspace.identity_key(name)):
        return True
    return is_awaited(session.package(name))  # no key is ever made for it here


def refuse_elsewhere(session: Session, name: str) -> None:
    """Refuse to make a new key for a package whose private key is not here.

    Raises:
        KeymintError: it is not here; what the authority decided about the package, or its sources, say so.
    """
    if session.issuance(name).public_key or session.package(name).identity.key.uri:
        raise KeymintError(
            f"the private key of {subject_of(name)} is not here, so no other one is made for it",
            where=place_of(session, name),
            help="run 'keymint request' on the machine that is to have the key, then 'keymint sign' here",
            code="key-elsewhere",
        )


def is_awaited(package: Package) -> bool:
    """Tell whether the key of a package lies in the token of its subject, and no request has brought its public key."""
    return bool(package.identity.key.uri) and not package.issuance.public_key


def unknown_key(package: Package) -> Diagnostic:
    """Return the finding on a package whose public key is not known here."""
    return Diagnostic.warning(
        "key-unknown",
        f"the key of {package.subject} lies in a token, and its public key is not known here: no certificate is issued",
        package.identity.origin,
        "run 'keymint request --pkcs11 …' on the machine that has the token, then 'keymint sign' here",
        package.subject,
    )


def private_key(session: Session, package: Package) -> bytes:
    """Return the stored private key of a package, in PEM; empty if it is elsewhere, or missing."""
    if package.issuance.public_key:
        return b""
    return session.tree.read(session.workspace.identity_key(package.name)) or b""


def public_key(session: Session, package: Package) -> keys.PublicKey:
    """Return the public key that a package's certificate is issued for.

    Raises:
        KeymintError: the stored private key cannot be used, is or should be encrypted, or the key lies in a token and
            is not known here.
    """
    if package.issuance.public_key:
        return public_keys.from_pem(package.issuance.public_key, place_of(session, package.name))
    if is_awaited(package):
        raise KeymintError.of([replace(unknown_key(package), severity=Severity.ERROR)])
    pem, place = private_key(session, package), _place(session, package.name)
    _require_plain(session, package, pem)
    return load_key(session, keys.public_of, pem, package.identity, place, _remedy(package.name))


def _place(inputs: Inputs, name: str) -> Origin:
    """Return the place of a package's stored private key."""
    return inputs.workspace.origin(inputs.workspace.identity_key(name))


def _require_plain(inputs: Inputs, package: Package, pem: bytes = b"") -> None:
    """Require that the key of an enclave needs no password, which no ROS 2 distribution passes to a node.

    Args:
        inputs: the workspace.
        package: the package.
        pem: its stored private key; empty if it has none yet.

    Raises:
        KeymintError: the sources ask for an encrypted key, or the stored one is encrypted.
    """
    why = "no ROS 2 distribution passes a password to a node, so a key in install/ is never encrypted"
    if package.identity.key.password_env:
        message, where = f"asks for an encrypted private key, but {why}", package.identity.origin
        help_ = "write NoEncryption and an empty <password_env>, there or in the defaults of identities"
    elif keys.is_encrypted(pem):
        message, where = f"is encrypted, but {why}", _place(inputs, package.name)
        help_ = f"make a new one with {_new(package.name)}"
    else:
        return
    raise KeymintError(message, where=where, help=help_, code="identity-encrypted")


def mint(inputs: Inputs, package: Package) -> tuple[FolderChange, str]:
    """Plan a new key for a package; returns the change, and the key's fingerprint.

    Raises:
        KeymintError: the sources ask for an encrypted one.
    """
    _require_plain(inputs, package)
    key = keys.generate(package.identity.key, package.identity.origin)
    pem = keys.to_pem(key)
    return secret_file(inputs.workspace.identity_key(package.name), pem), keys.fingerprint(key)


def restore_or_mint(session: Session, package: Package) -> tuple[FolderChange, str]:
    """Plan the key of a package that has none: the one in its enclave, or a new one if it never had any.

    Raises:
        KeymintError: it had a key, which is no longer in its enclave; or the sources ask for an encrypted one.
    """
    _require_plain(session, package)
    known = known_fingerprint(session, package.name)
    if not known:
        return mint(session, package)
    pem = session.tree.try_read(session.enclave(package.name) / KEY) or b""
    try:
        there = keys.fingerprint(keys.from_pem(pem)) if pem else ""
    except KeymintError:
        there = ""
    if there != known:
        raise KeymintError(
            f"the private key of {subject_of(package.name)} is missing",
            where=_place(session, package.name),
            help=f"restore it from a backup, or mint a new one with {_new(package.name)}",
            code="key-missing",
        )
    return secret_file(session.workspace.identity_key(package.name), pem), there


def known_fingerprint(session: Session, name: str) -> str:
    """Return the fingerprint of the key that a package's subject has, or an empty text.

    That is the recorded key, or if the record was lost the key of the installed certificate. Before anything is
    installed the subject has none: the user may replace the minted key with one of their own.
    """
    recorded = recorded_key(session.state, IDENTITY_KEYS, name)
    if recorded and session.state.stamp(INSTALLED, name):
        return recorded
    certificate = installed_certificate(session, name)
    return (recorded or certificates.fingerprint(certificate)) if certificate else ""


class Keyring:
    """The known keys of subjects and authorities, to compare the stored key of a subject with.

    Args:
        session: the workspace and its profile, with the authorities as they will be.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._authorities = authority_keys(session)

    def require_own(self, package: Package, key: keys.PublicKey) -> str:
        """Require that the key of a package is its subject's, and nobody else's; returns its fingerprint.

        Args:
            package: the package.
            key: its public key.

        Raises:
            KeymintError: it is an authority's key, was replaced, or belongs to another subject.
        """
        name, session = package.name, self._session
        if package.issuance.public_key:
            return self.require_free(name, key)
        state, fingerprint = session.state, keys.fingerprint(key)
        if fingerprint in self._authorities:
            owner = f"the authority {self._authorities[fingerprint]!r}"
            raise _shared(session, name, owner, "key-of-authority")
        known = known_fingerprint(session, name)
        if known and known != fingerprint:
            raise KeymintError(
                f"is not the private key that {subject_of(name)} had: it was replaced",
                where=_place(session, name),
                help=_remedy(name),
                code="key-replaced",
            )
        if recorded_key(state, IDENTITY_KEYS, name) != fingerprint:  # so it may not be its own
            for other in self._owners.get(fingerprint, ()):
                if other != name:
                    raise _shared(session, name, subject_of(other))
        return fingerprint

    def require_free(self, name: str, key: keys.PublicKey) -> str:
        """Require that a key whose private half is elsewhere is nobody else's; returns its fingerprint.

        It may differ from the one that the subject had: an authority decided so in the sources.

        Args:
            name: the package.
            key: its public key.

        Raises:
            KeymintError: it is an authority's key, or belongs to another subject.
        """
        fingerprint = keys.fingerprint(key)
        owner = f"the authority {self._authorities[fingerprint]!r}" if fingerprint in self._authorities else ""
        others = [other for other in self._owners.get(fingerprint, ()) if other != name]
        if owner or others:
            raise KeymintError(
                f"the public key of {subject_of(name)} is that of {owner or subject_of(others[0])}",
                where=place_of(self._session, name),
                help="make a new key with 'keymint request' on the machine of this subject, then run 'keymint sign'",
                code="key-of-authority" if owner else "key-shared",
            )
        return fingerprint

    @functools.cached_property
    def _owners(self) -> Mapping[str, Sequence[str]]:
        """Packages by the fingerprints of their keys."""
        recorded = self._session.state.stamps.get(IDENTITY_KEYS, {})
        owners: dict[str, list[str]] = {}
        for name in sorted({*recorded, *enclave_names(self._session)}):
            if name in recorded:
                owners.setdefault(recorded[name].inputs, []).append(name)
            elif certificate := installed_certificate(self._session, name):
                owners.setdefault(certificates.fingerprint(certificate), []).append(name)
        return owners


def shared_keys(inputs: Inputs, fingerprints: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Yield an error for each key that two packages have; takes fingerprints by package."""
    owners: dict[str, str] = {}
    for name, fingerprint in fingerprints.items():
        other = owners.setdefault(fingerprint, name)
        if other != name:
            found = _shared(inputs, name, subject_of(other)).diagnostics
            yield from (replace(each, subject=subject_of(name)) for each in found)


def _shared(inputs: Inputs, name: str, owner: str, code: str = "key-shared") -> KeymintError:
    """Return the error for a subject that has the key of another one, or of an authority."""
    return KeymintError(
        f"is the private key of {owner} as well, so that each could act as the other",
        where=_place(inputs, name),
        help=_remedy(name),
        code=code,
    )
