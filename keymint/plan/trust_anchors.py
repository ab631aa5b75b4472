# SPDX-License-Identifier: Apache-2.0
"""Trust anchors: the workspace's authorities that an enclave must rest on, and where it does not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic
from keymint.api import Package, Prover, TrustAnchor, TrustAnchors
from keymint.plan import authority_evidence
from keymint.plan.authority_files import trusted_chains
from keymint.plan.enclaves import TAKEN, enclave_files
from keymint.session import Session


def anchors_of(session: Session, package: Package, chains: Mapping[str, bytes]) -> TrustAnchors:
    """Return the trust anchors that the enclave of a package must rest on.

    Args:
        session: the workspace and its profile.
        package: the package.
        chains: certificates of the authorities by name; see :func:`keymint.plan.authority_files.trusted_chains`.
    """
    workspace = session.workspace

    def anchor(name: str) -> TrustAnchor:
        return TrustAnchor(name, workspace.shown(workspace.authority_certificate(name)), chains.get(name, b""))

    return TrustAnchors(
        anchor(package.identity.issuer),
        anchor(package.grant.issuer),
        package.identity.subject_name,
        session.profile.layout,
    )


def differences(session: Session, names: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return the findings on enclaves that do not rest on the workspace's authorities.

    Enclaves that are not installed, or whose build type cannot tell, have none.

    Raises:
        KeymintError: a package has defects.
    """
    findings: list[Diagnostic] = []
    chains, contradictions = trusted_chains(session), authority_evidence.contradictions(session)
    for name in names:
        files, unread = enclave_files(session, name)
        findings += (each for each in unread if each.where is not None and each.where.file.endswith(TAKEN))
        if not files:
            continue
        package = session.package(name)
        findings += authority_evidence.contradictions_for(contradictions, package)
        build_type = session.plugins.build_type(package.build_type, session.package_marker(name))
        if isinstance(build_type, Prover):
            anchors = anchors_of(session, package, chains)
            folder = session.workspace.shown(session.enclaves / name)
            differences = build_type.differences(files, folder, anchors)
            findings += (replace(each, subject=package.subject) for each in differences)
    return tuple(dict.fromkeys(findings))
