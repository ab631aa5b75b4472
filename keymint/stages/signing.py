# SPDX-License-Identifier: Apache-2.0
"""Issue the certificate of a package's subject, and sign its documents."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from cryptography import x509

from comarmor.errors import Diagnostic, Origin
from keymint.api import Artifact, EnclaveCredentials, Package, SigningAuthority
from keymint.authority.authorities import MintedAuthority
from keymint.authority.authority_files import trusted_chains
from keymint.errors import KeymintError, known_authority
from keymint.life.package_issuance import place_of
from keymint.life.register import SUPERSEDED, IssuedCertificate, Register
from keymint.life.revocation_lists_in_force import enclave_lists
from keymint.life.workspace_register import entry_of, issuer_of, register_of
from keymint.pki import certificates, keys
from keymint.view.stamps import digest_files
from keymint.workspace.installed_enclaves import CERTIFICATE
from keymint.workspace.package_build_types import build_types_of, roles_of, two_writers
from keymint.workspace.session import Session
from keymint.workspace.workspace import with_place


def sign(
    session: Session,
    package: Package,
    documents: Mapping[str, bytes],
    authorities: Mapping[str, MintedAuthority],
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
    certificate = _going_on(package, public, issuer.certificate, existing.get(CERTIFICATE), register)
    warnings: Sequence[Diagnostic] = ()
    if certificate is not None:
        loaded = certificates.load(certificate)
    else:
        issued = certificates.issue_identity(package.identity, public, issuer.issuer)
        certificate, loaded = issued.pem, issued.certificate
        warnings = [replace(warning, subject=package.subject) for warning in issued.diagnostics]
    artifacts: dict[str, Artifact] = {}
    writers: dict[str, str] = {}
    for name, build_type in build_types_of(session, package).items():
        credentials = EnclaveCredentials(
            certificate=certificate,
            key=pem,
            chains={role.role: trusted_chains(session)[role.name] for role, _ in roles[name]},
            signers=Signers({role.role: authority for role, authority in roles[name] if role.signs}),
            revocations=enclave_lists(session).get(package.identity.issuer, b""),
        )
        try:
            own = build_type.install(package, documents, credentials, session.profile.layout, existing)
        except KeymintError as error:
            raise KeymintError.of([_placed(each, session, package) for each in error.diagnostics]) from error
        different = {file for file, artifact in own.items() if artifacts.get(file, artifact) != artifact}
        if conflicts := two_writers(session, package, writers, name, own, different):
            raise KeymintError.of(conflicts)
        artifacts |= own
    identity, generation, rights = package.identity, package.issuance.generation, digest_files(documents)
    entry = entry_of(loaded, issuer.certificate, identity.issuer, package.name, generation, rights)
    return artifacts, entry, warnings


def _placed(diagnostic: Diagnostic, session: Session, package: Package) -> Diagnostic:
    """Return a diagnostic with its full path: build types name the package's documents relative to ``build/``."""
    is_of_document = diagnostic.where is not None and diagnostic.where.file.startswith(f"{package.name}/")
    return with_place(diagnostic, session.workspace.build) if is_of_document else diagnostic


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
        KeymintError: it would be, so that old signed rights would fit the new certificate.
    """
    own, lowest = package.issuance.generation, register.generation(package.name)
    if own < lowest:
        reason = next((each.reason for each in reversed(register.of(package.name)) if each.reason), SUPERSEDED)
        raise KeymintError(
            f"the sources have generation {own}, but generation {lowest} is the lowest that may be issued",
            where=place_of(session, package.name),
            help=f"restore the file; or 'keymint revoke {package.name} --reason {reason}' writes the generation again",
            code="generation-back",
        )


def authority_of(authorities: Mapping[str, MintedAuthority], name: str, origin: Origin) -> MintedAuthority:
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


class Signers(Mapping[str, SigningAuthority]):
    """Signing authorities by role; access to one whose key is elsewhere raises a KeymintError that says so.

    Args:
        authorities: the authorities by role.
    """

    def __init__(self, authorities: Mapping[str, MintedAuthority]) -> None:
        self._authorities = authorities

    def __getitem__(self, role: str) -> SigningAuthority:
        return self._authorities[role].signer

    def __iter__(self) -> Iterator[str]:
        return iter(self._authorities)

    def __len__(self) -> int:
        return len(self._authorities)
