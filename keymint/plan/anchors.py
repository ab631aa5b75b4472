"""Trust anchors: the authorities of the workspace that an enclave must rest on, and what in it does not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

from comarmor.errors import Diagnostic
from keymint.api import Anchor, Anchors, Package, Prover
from keymint.plan import vouching
from keymint.plan.authorities import trusted_chains
from keymint.plan.enclaves import TAKEN, enclave_files
from keymint.plan.inputs import Inputs, LoadedProfile, Sources


def anchors_of(inputs: Inputs, loaded: LoadedProfile, package: Package, chains: Mapping[str, bytes]) -> Anchors:
    """Return what the enclave of a package must rest on.

    Args:
        inputs: the workspace.
        loaded: its profile.
        package: the package.
        chains: certificates of the authorities by name; see :func:`keymint.plan.authorities.trusted_chains`.
    """
    workspace = inputs.workspace

    def anchor(name: str) -> Anchor:
        return Anchor(name, workspace.shown(workspace.authority_certificate(name)), chains.get(name, b""))

    return Anchors(
        anchor(package.identity.issuer),
        anchor(package.permissions.issuer),
        package.identity.subject_name,
        loaded.profile.layout,
    )


def differences(
    inputs: Inputs, loaded: LoadedProfile, names: Sequence[str], sources: Sources
) -> tuple[Diagnostic, ...]:
    """Return what in the enclaves of some packages does not rest on the workspace's authorities.

    An enclave that is not installed, and one whose build type cannot tell, has none.

    Raises:
        KeymintError: a package has defects.
    """
    found: list[Diagnostic] = []
    chains, doubts = trusted_chains(inputs, loaded), vouching.doubts(inputs, loaded)
    for name in names:
        folder = inputs.workspace.enclaves(loaded.profile.layout) / name
        files, unread = enclave_files(inputs, folder, f"/{name}")
        found += (each for each in unread if each.where is not None and each.where.file.endswith(TAKEN))
        if not files:
            continue
        package = sources.load(inputs, loaded, name, sources.files(inputs, name))
        found += vouching.about(doubts, package)
        build_type = inputs.plugins.build_type(package.build_type, inputs.package_marker(name))
        if hasattr(build_type, "differences"):
            anchors = anchors_of(inputs, loaded, package, chains)
            told = cast("Prover", build_type).differences(files, inputs.workspace.shown(folder), anchors)
            found += (replace(each, subject=package.subject) for each in told)
    return tuple(dict.fromkeys(found))
