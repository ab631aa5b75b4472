# SPDX-License-Identifier: Apache-2.0
"""The identity of each subject: its private key, and its certificate with the documents that are signed for it.

A key is minted once, restored from its enclave, and never replaced without a request: a replaced key would give the
subject's permissions to whoever replaced it.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Mapping, Sequence
from typing import Any

from cryptography import x509

from comarmor.values import replace
from keymint.api import Artifact, Credentials, Package, SigningAuthority
from keymint.authority.authorities import Authorities, MintedAuthority
from keymint.authority.authority_files import trusted_chains
from keymint.errors import Diagnostic, KeymintError, Origin, Severity, known_authority, require_none
from keymint.life.register import SUPERSEDED, IssuedCertificate, Register
from keymint.life.revocation_lists_in_force import enclave_lists
from keymint.life.workspace_register import entry_of, has_register, issuer_of, outdated_register, register_of, withdrawn
from keymint.names import subject_of
from keymint.pki import certificates, keys
from keymint.store.changes import FolderChange, secret_file
from keymint.view.stamps import digest, digest_files
from keymint.workspace.installed_enclaves import CERTIFICATE, KEY, not_installed
from keymint.workspace.package_build_types import build_types_of, roles_of, two_writers
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import (
    key_place,
    key_remedy,
    key_renewal,
    known_fingerprint,
    load_key,
    missing_key_remedy,
)
from keymint.workspace.workspace import with_place


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


def is_awaited(package: Package) -> bool:
    """Tell whether the key of a package lies in the token of its subject, and no request has brought its public key."""
    return bool(package.identity.key.uri) and not package.issuance.public_key


def unknown_key(package: Package) -> Diagnostic:
    """Return the finding on a package whose public key is not known here."""
    message = f"the key of {package.subject} lies in a token; without its public key, no certificate is issued"
    help_ = "run 'keymint request --pkcs11 …' on the machine that has the token, then 'keymint sign' here"
    return Diagnostic.warning("key-unknown", message, package.identity.origin, help_, package.subject)


def missing_enclave(session: Session, package: Package) -> Diagnostic:
    """Return the finding on a package without an enclave; before the robot's request nothing can be installed.

    Raises:
        KeymintError: the register has defects.
    """
    folder, reason = session.enclave_folder(package.name), withdrawn(session).get(package.name, "")
    missing = not_installed(package.name, session.workspace.shown(folder), reason)
    return replace(missing, help=unknown_key(package).help) if is_awaited(package) else missing


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
        return keys.public_from_pem(package.issuance.public_key, session.issuance_place(package.name))
    if is_awaited(package):
        raise KeymintError.of([replace(unknown_key(package), severity=Severity.ERROR)])
    pem, place = private_key(session, package), key_place(session, package.name)
    _require_plain(session, package, pem)
    return load_key(session, keys.public_of, pem, package.identity, place, key_remedy(package.name))


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
        message, where = f"is encrypted, but {why}", key_place(inputs, package.name)
        help_ = f"make a new one with {key_renewal(package.name)}"
    else:
        return
    raise KeymintError(message, where=where, help=help_, code="identity-encrypted")


def mint(inputs: Inputs, package: Package) -> tuple[FolderChange, str]:
    """Plan a new key for a package, and return its fingerprint as well.

    Raises:
        KeymintError: the sources ask for an encrypted key.
    """
    _require_plain(inputs, package)
    minted = keys.to_pem(keys.generate(package.identity.key, package.identity.origin))
    return secret_file(inputs.workspace.identity_key(package.name), minted), keys.fingerprint_of_file(minted)


def restore_or_mint(session: Session, package: Package, *, rekey: bool, restore: bool) -> tuple[FolderChange, str]:
    """Plan the key of a package: a new one if it never had any, else the one in its enclave, if the user asks for that.

    Who deletes a key may want to be rid of it, so it never comes back by itself.

    Args:
        session: the workspace and its profile.
        package: the package, which has no key in the workspace, or is to get another one.
        rekey: it is to get a new one.
        restore: it is to get the one in its enclave.

    Returns:
        The change, and the key's fingerprint.

    Raises:
        KeymintError: it had a key, which is no longer in its enclave, or was not asked for; or the sources ask for an
            encrypted one.
    """
    _require_plain(session, package)
    path = session.workspace.identity_key(package.name)
    known = "" if rekey else known_fingerprint(session, package.name)
    if not known:
        return mint(session, package)
    pem, in_enclave = _enclave_key(session, package.name, known)
    if not in_enclave or not restore:
        raise missing_key(session, package.name)
    return secret_file(path, pem), known


def missing_key(session: Session, name: str) -> KeymintError:
    """Return the error that a package's private key is missing, with the one remedy that is left."""
    _, in_enclave = _enclave_key(session, name, known_fingerprint(session, name))
    message, help_ = (
        f"the private key of {subject_of(name)} is missing",
        missing_key_remedy(name, in_enclave=in_enclave),
    )
    return KeymintError(message, where=key_place(session, name), help=help_, code="key-missing")


def _enclave_key(session: Session, name: str, known: str) -> tuple[bytes, bool]:
    """Return the private key in an enclave, and whether it is the one with a fingerprint."""
    pem = session.tree.try_read(session.enclave(name) / KEY) or b""
    try:
        return pem, bool(pem) and keys.fingerprint(keys.from_pem(pem)) == known
    except KeymintError:
        return pem, False


# -- the certificate, and signatures --------------------------------------------------------------------------------


def sign(
    session: Session,
    package: Package,
    documents: Mapping[str, bytes],
    authorities: Authorities,
    key: tuple[bytes, keys.PublicKey],
    existing: Mapping[str, bytes],
) -> tuple[Mapping[str, Artifact], IssuedCertificate, Sequence[Diagnostic]]:
    """Return the files of an enclave, its certificate's entry in the register, and warnings.

    A certificate that is still right, and not revoked, is kept.

    Args:
        session: the workspace and its profile.
        package: the package.
        documents: its unsigned documents by file name.
        authorities: the authorities by name.
        key: the subject's private key (PEM) and public key.
        existing: the enclave's present files.

    Raises:
        KeymintError: an authority is unknown or cannot sign, the documents cannot be signed, or a later generation
            of the package was issued.
    """
    issuer = authority_of(authorities, package.identity.issuer, package.identity.origin)
    roles = {
        name: [(role, authority_of(authorities, role.name, role.origin)) for role in of_type]
        for name, of_type in roles_of(session, package).items()
    }
    register = register_of(session)
    _require_generation(session, package, register)
    pem, public = key
    going_on = certificate = _going_on(package, public, issuer.certificate, existing.get(CERTIFICATE), register)
    warnings: Sequence[Diagnostic] = ()
    if certificate is not None:
        loaded = certificates.load(certificate)
    else:
        issued = certificates.issue(package.identity, public, issuer.issuer, authority=False)
        certificate, loaded = issued.pem, issued.certificate
        warnings = [replace(warning, subject=package.subject) for warning in issued.diagnostics]
    artifacts: dict[str, Artifact] = {}
    writers: dict[str, str] = {}
    for name, build_type in build_types_of(session, package).items():
        credentials = Credentials(
            certificate=certificate,
            key=pem,
            chains={role.role: trusted_chains(session)[role.name] for role, _ in roles[name]},
            signers=Signers({role.role: authority for role, authority in roles[name] if role.signs}),
            revocations=enclave_lists(session).get(package.identity.issuer, b""),
        )
        try:
            own = build_type.install(package, documents, credentials, session.profile.layout, existing)
        except KeymintError as error:
            # Build types name the package's documents relative to build/.
            own_documents, build = f"{package.name}/", session.workspace.build
            raise KeymintError.of(
                with_place(each, build) if each.where and each.where.file.startswith(own_documents) else each
                for each in error.diagnostics
            ) from error
        different = {file for file in own.keys() & artifacts.keys() if artifacts[file] != own[file]}
        require_none(two_writers(session, package, writers, name, own, different))
        artifacts |= own
    identity, generation, rights = package.identity, package.issuance.generation, digest_files(documents)
    issuer_key, now = issuer_of(issuer.certificate), session.now if going_on is None else None
    entry = entry_of(loaded, issuer_key, identity.issuer, package.name, generation, rights, now)
    return artifacts, entry, warnings


def _going_on(
    package: Package, public: keys.PublicKey, issuer: x509.Certificate, existing: bytes | None, register: Register
) -> bytes | None:
    """Return the certificate that is still right, and not revoked; None if there is none.

    Args:
        package: the package.
        public: the key of its subject.
        issuer: the issuer's current certificate.
        existing: the certificate in the enclave.
        register: the register of certificates.
    """
    identity, taken_over = package.identity, package.issuance.certificate
    found: list[bytes] = []
    if taken_over and certificates.certificate_fits(taken_over, identity, public, issuer):
        same = existing is not None and certificates.is_same(existing, taken_over)
        found.append(existing if same and existing else taken_over)  # the file may encode it in another way
    if existing is not None and certificates.certificate_satisfies(existing, identity, public, issuer, authority=False):
        found.append(existing)
    name = issuer_of(issuer)
    return next((each for each in found if not register.is_revoked(name, certificates.load(each).serial_number)), None)


def _require_generation(session: Session, package: Package, register: Register) -> None:
    """Require that nothing is issued for a generation that was revoked or followed by another one.

    Raises:
        KeymintError: it would be, so that old signed rights would fit the new certificate; or the register does not
            know of a revocation that raised the generation, so that the key may be one that was revoked.
    """
    own, lowest = package.issuance.generation, register.generation(package.name)
    if own < lowest:
        reason = next((each.reason for each in reversed(register.of(package.name)) if each.reason), SUPERSEDED)
        message = f"the sources have generation {own}, but generation {lowest} is the lowest that may be issued"
        help_ = f"restore the file; or 'keymint revoke {package.name} --reason {reason}' writes the generation again"
        raise KeymintError(message, where=session.issuance_place(package.name), help=help_, code="generation-back")
    if own > lowest and has_register(session):
        lacks = (
            f"the revocation that gave {package.subject} the generation {own} in {session.issuance_place(package.name)}"
        )
        raise outdated_register(session, f"{lacks}: it is older, so the key may be one that was revoked")


def authority_of(authorities: Authorities, name: str, origin: Origin) -> MintedAuthority:
    """Return an authority by its name.

    Args:
        authorities: the authorities by name.
        name: the name.
        origin: the place that names it, for the message.

    Raises:
        KeymintError: there is none of this name.
    """
    return authorities[known_authority(name, authorities, origin, "signs this")]


# -- the authorities that sign, each asked for its key only when something must be signed -----------------------------


class Signers(UserDict[str, Any]):
    """Signing authorities by role; access to one whose key is elsewhere raises a KeymintError that says so.

    Args:
        authorities: the authorities by role.
    """

    def __getitem__(self, role: str) -> SigningAuthority:
        minted: MintedAuthority = self.data[role]
        return minted.signer
