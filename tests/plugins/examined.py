# SPDX-License-Identifier: Apache-2.0
"""What ``keymint check`` asks a build type about an enclave: its own rules, and those on trust anchors."""

from __future__ import annotations

from typing import Any

from comarmor.errors import Diagnostic
from keymint.api import EnclaveFiles, Inspection, TrustAnchor, TrustAnchors


def examined(build_type: Any, asked: Inspection) -> tuple[Diagnostic, ...]:
    """Return the findings of a build type on an enclave; of two on one thing only the first."""
    package = asked.package
    authorities = {role: TrustAnchor(role, f"public/{role}.cert.pem", chain) for role, chain in asked.chains.items()}
    identity, public_key = package.identity, package.issuance.public_key
    anchors = TrustAnchors(
        authorities, identity.subject_name, asked.layout, public_key, identity.key.uri, package.distro
    )
    own = build_type.check(asked)
    known = {(each.code, each.where) for each in own}
    more = build_type.prover.differences(EnclaveFiles(asked.files, asked.folder, anchors))
    of_enclave = (each for each in more if each.where and each.where.file.startswith(f"{asked.folder}/"))
    return (*own, *(each for each in (*of_enclave, *_of_anchors(more)) if (each.code, each.where) not in known))


def _of_anchors(found: tuple[Diagnostic, ...]) -> tuple[Diagnostic, ...]:
    return tuple(each for each in found if each.where and each.where.file.startswith("public/"))
