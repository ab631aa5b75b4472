"""What is found on one installed enclave: by its build type, on the disk, and against the record."""

from __future__ import annotations

import stat
from collections.abc import Iterator, Mapping
from datetime import timedelta
from pathlib import Path

from keymint.api import BuildOptions, Inspection, Package
from keymint.check.places import modes
from keymint.errors import Diagnostic, Origin, Severity
from keymint.plan import install
from keymint.plan.authorities import trusted_chains
from keymint.plan.inputs import Inputs, LoadedProfile
from keymint.state import digest


def inspection(inputs: Inputs, loaded: LoadedProfile, package: Package, within: timedelta) -> Inspection:
    """Return what a build type needs to judge the enclave of a package."""
    workspace = inputs.workspace
    folder = workspace.enclaves(loaded.profile.layout) / package.name
    chains = trusted_chains(inputs, loaded)
    # What the policy says that vendors read differently was said, and accepted, when it was built.
    built = inputs.plugins.build_type(package.build_type, inputs.package_marker(package.name)).build(
        package, BuildOptions(allow_vendor_specific=True)
    )
    return Inspection(
        package=package,
        documents=built.documents,
        files=installed_files(inputs, folder),
        folder=workspace.shown(folder),
        layout=loaded.profile.layout,
        identity_ca=chains.get(package.identity.issuer, b""),
        permissions_ca=chains.get(package.permissions.issuer, b""),
        now=inputs.now,
        within_days=within / timedelta(days=1),
    )


def installed_files(inputs: Inputs, folder: Path) -> dict[str, bytes]:
    """Return the enclave's regular files; a link is a finding of its own."""
    return {
        name: inputs.tree.read(folder / name) or b""
        for name, is_folder in inputs.tree.names(folder)
        if not is_folder and stat.S_ISREG((folder / name).lstat().st_mode)
    }


def on_disk(inputs: Inputs, loaded: LoadedProfile, name: str, files: Mapping[str, bytes]) -> Iterator[Diagnostic]:
    """Judge modes, links and recorded digests of one enclave."""
    workspace = inputs.workspace
    folder = workspace.enclaves(loaded.profile.layout) / name
    stamp = inputs.state.stamp(install.STAGE, name)
    secret = stamp.secret if stamp else ("key.pem",)
    yield from modes(workspace.shown(folder), folder, 0o700, f"/{name}")
    for file, is_folder in inputs.tree.names(folder):
        if not is_folder:
            mode = 0o600 if file in secret else 0o644
            yield from modes(workspace.shown(folder / file), folder / file, mode, f"/{name}")
    yield from modes(workspace.shown(workspace.identity_key(name)), workspace.identity_key(name), 0o600, f"/{name}")
    if stamp is None:
        yield Diagnostic(
            "record-missing",
            Severity.NOTE,
            f"there is no record of what was installed as /{name}",
            None,
            "'keymint install' makes one",
            f"/{name}",
        )
        return
    for file, value in stamp.outputs.items():
        if file in files and digest(files[file]) != value:
            yield Diagnostic(
                "file-changed",
                Severity.ERROR,
                "was changed after it was installed",
                Origin(workspace.shown(folder / file)),
                f"'keymint install {name}' restores it",
                f"/{name}",
            )
