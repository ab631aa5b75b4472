# SPDX-License-Identifier: Apache-2.0
"""Issue the certificate of a package's subject, and sign its documents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin
from comarmor.text import did_you_mean
from keymint.api import Artifact, EnclaveCredentials, Package
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.plan.authorities import MintedAuthority
from keymint.plan.build_types import build_types_of, roles_of, two_writers
from keymint.plan.enclaves import CERTIFICATE
from keymint.session import Session
from keymint.workspace import placed


def sign(
    session: Session,
    package: Package,
    documents: Mapping[str, bytes],
    authorities: Mapping[str, MintedAuthority],
    key: tuple[bytes, keys.PublicKey],
    existing: Mapping[str, bytes],
) -> tuple[Mapping[str, Artifact], Sequence[Diagnostic]]:
    """Return the files of an enclave, and warnings; a certificate that is still right is kept.

    Args:
        session: the workspace and its profile.
        package: the package.
        documents: its unsigned documents by file name.
        authorities: the authorities by name.
        key: the subject's private key (PEM) and public key.
        existing: the enclave's present files.

    Raises:
        KeymintError: an authority is unknown or cannot sign, or the documents cannot be signed.
    """
    issuer = authority_of(authorities, package.identity.issuer, package.identity.origin)
    roles = {
        name: [(role, authority_of(authorities, role.name, role.origin)) for role in of_type]
        for name, of_type in roles_of(session, package).items()
    }
    pem, public = key
    certificate = existing.get(CERTIFICATE)
    warnings: Sequence[Diagnostic] = ()
    if certificate is None or not certificates.certificate_satisfies(
        certificate, package.identity, public, issuer.issuer.certificate, authority=False
    ):
        issued = certificates.issue_identity(package.identity, public, issuer.issuer)
        certificate = issued.pem
        warnings = [replace(warning, subject=package.subject) for warning in issued.diagnostics]
    artifacts: dict[str, Artifact] = {}
    writers: dict[str, str] = {}
    for name, build_type in build_types_of(session, package).items():
        credentials = EnclaveCredentials(
            certificate=certificate,
            key=pem,
            chains={role.role: authority.chain for role, authority in roles[name]},
            signers={role.role: authority.signer for role, authority in roles[name] if role.signs},
        )
        try:
            own = build_type.install(package, documents, credentials, session.profile.layout, existing)
        except KeymintError as error:
            raise KeymintError.of(
                [placed(diagnostic, session.workspace.build) for diagnostic in error.diagnostics]
            ) from error
        different = {file for file, artifact in own.items() if artifacts.get(file, artifact) != artifact}
        if conflicts := two_writers(session, package, writers, name, own, different):
            raise KeymintError.of(conflicts)
        artifacts |= own
    return artifacts, warnings


def authority_of(authorities: Mapping[str, MintedAuthority], name: str, origin: Origin) -> MintedAuthority:
    """Return an authority by its name.

    Args:
        authorities: the authorities by name.
        name: the name.
        origin: the place that names it, for the message.

    Raises:
        KeymintError: there is none of this name.
    """
    if name not in authorities:
        raise KeymintError(
            f"no authority {name!r} in the profile, which has {', '.join(sorted(authorities)) or 'none'}",
            where=origin,
            help=did_you_mean(name, authorities, "name one in issuer_name"),
            code="authority-unknown",
        )
    return authorities[name]
