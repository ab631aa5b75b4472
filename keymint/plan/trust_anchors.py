# SPDX-License-Identifier: Apache-2.0
"""Trust anchors: the workspace's authorities that an enclave must rest on, and where it does not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic
from keymint.api import BuildType, Package, TrustAnchor, TrustAnchors
from keymint.plan import authority_evidence
from keymint.plan.authority_files import trusted_chains
from keymint.plan.build import is_current
from keymint.plan.build_types import build_types_of, issuers_of, prover_of, suffixes_read
from keymint.plan.enclaves import enclave_files
from keymint.plan.shared_install import shared_roles
from keymint.plan.shared_proof import installed_documents
from keymint.session import Session, once


def anchors_of(session: Session, package: Package, build_type: BuildType) -> TrustAnchors:
    """Return the trust anchors that the enclave of a package must rest on.

    Args:
        session: the workspace and its profile.
        package: the package.
        build_type: one of its build types.
    """
    authorities = {role.role: _anchor(session, (role.name,)) for role in build_type.authorities(package)}
    identity, layout, public_key = package.identity, session.profile.layout, package.issuance.public_key
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


def differences(session: Session, names: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return the findings on enclaves that do not rest on the workspace's authorities.

    Enclaves that are not installed, or whose build type cannot tell, have none.

    Raises:
        KeymintError: a package has defects.
    """
    findings: list[Diagnostic] = []
    contradictions = authority_evidence.contradictions(session)
    for name in names:
        files, unread = enclave_files(session, name)
        if not (files or unread):
            continue
        package = session.package(name, built=is_current(session, name))
        suffixes = suffixes_read(session, package)
        findings += (each for each in unread if each.where is not None and each.where.file.endswith(suffixes))
        if not files:
            continue
        issuers = issuers_of(session, package)
        findings += authority_evidence.contradictions_for(contradictions, issuers)
        folder = session.workspace.shown(session.enclave_folder(name))
        for build_type, plugin in build_types_of(session, package).items():
            if prover := prover_of(session, build_type):
                anchors = anchors_of(session, package, plugin)
                shared = installed_documents(session, build_type)
                shown = session.workspace.shown(session.workspace.install)
                found = prover.differences(files, folder, anchors, shared, shown)
                findings += (replace(each, subject=package.subject) for each in found)
    return tuple(dict.fromkeys(findings))
