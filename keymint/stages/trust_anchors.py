# SPDX-License-Identifier: Apache-2.0
"""Trust anchors: the workspace's authorities that an enclave must rest on.

Proofs rest on the certificates in ``public/``; what speaks against one is judged in :mod:`keymint.authority.examine`.
Whether an enclave rests on them is asked of its build type.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from comarmor.values import replace
from keymint.api import BuildType, EnclaveFiles, Package, TrustAnchor, TrustAnchors
from keymint.authority.authority_files import trusted_chains
from keymint.authority.examine import contradictions_for
from keymint.errors import Diagnostic
from keymint.pki import keys
from keymint.stages.documents import installed_documents, shared_roles
from keymint.workspace.installed_enclaves import INSTALLED, KEY, enclave_files, installed_certificate
from keymint.workspace.package_build_types import build_types_of, is_build_current
from keymint.workspace.session import Session, once


def anchors_of(session: Session, package: Package, build_type: BuildType) -> TrustAnchors:
    """Return the trust anchors that the enclave of a package must rest on.

    Args:
        session: the workspace and its profile.
        package: the package.
        build_type: one of its build types.
    """
    authorities = {role.role: _anchor(session, (role.name,)) for role in build_type.authorities(package)}
    identity, layout, public_key = package.identity, session.profile.layout, package.issuance.public_key
    if not public_key and session.tree.is_left_out(f"{session.enclave_folder(package.name)}/{KEY}"):
        # This user may not read it, and is told so: it is not compared with the certificate.
        certificate = installed_certificate(session, package.name)
        own = certificate and certificate.public_key()
        public_key = keys.public_to_pem(own) if isinstance(own, keys.PublicKey) else b""
    distro = session.vendors_of or package.distro
    return TrustAnchors(authorities, identity.subject_name, layout, public_key, identity.key.uri, distro)


def shared_anchors(session: Session, packages: Iterable[Package], build_type: BuildType) -> Mapping[str, TrustAnchor]:
    """Return the trust anchors by role that the shared documents of a build type must rest on.

    Args:
        session: the workspace and its profile.
        packages: the packages of the build type.
        build_type: the build type.

    Raises:
        KeymintError: two packages have different authorities in a role that signs.
    """
    return {
        role: _anchor(session, tuple(each.name for each in of_role))
        for role, of_role in shared_roles(packages, build_type).items()
    }


@once
def _anchor(session: Session, names: tuple[str, ...]) -> TrustAnchor:
    """Return the trust anchor of some authorities."""
    workspace, chains = session.workspace, trusted_chains(session)
    files = ", ".join(workspace.shown(workspace.authority_certificate(name)) for name in names)
    return TrustAnchor(", ".join(names), files, b"".join(dict.fromkeys(chains.get(name, b"") for name in names)))


def unread_of(session: Session, package: Package, unread: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return the findings on unreadable files that belong to an enclave, by the record or by their names."""
    suffixes = tuple(suffix for each in build_types_of(session, package).values() for suffix in each.READS)
    stamp = session.state.stamp(INSTALLED, package.name)
    named = ((each.where.file.rpartition("/")[2] if each.where else "", each) for each in unread)
    own = {*stamp.outputs, ""} if stamp else {""}
    return tuple(each for file, each in named if file in own or file.endswith(suffixes))


def differences(session: Session, names: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return the findings on enclaves that do not rest on the workspace's authorities.

    Enclaves that are not installed, or whose build type cannot tell, have none.

    Raises:
        KeymintError: a package has defects.
    """
    there = [name for name in names if any(enclave_files(session, name))]
    packages = (session.package(name, built=is_build_current(session, name)) for name in there)
    return tuple(dict.fromkeys(each for package in packages for each in unvouched_files(session, package)))


def unvouched_files(session: Session, package: Package) -> Iterator[Diagnostic]:
    """Yield the findings on an enclave, of which some file is there, that does not rest on the authorities."""
    files, unread = enclave_files(session, package.name)
    yield from unread_of(session, package, unread)
    if not files:
        return
    yield from contradictions_for(session, package.name)
    workspace = session.workspace
    folder, install = workspace.shown(session.enclave_folder(package.name)), workspace.shown(workspace.install)
    for build_type, plugin in build_types_of(session, package).items():
        if prover := plugin.prover:
            anchors, shared = anchors_of(session, package, plugin), installed_documents(session, build_type)
            found = prover.differences(EnclaveFiles(files, folder, anchors, shared, install))
            yield from (replace(each, subject=package.subject) for each in found)
