"""Holds what is installed against what it should be: ``keymint check``.

What concerns the content of an enclave is judged by its build type. Here is what concerns the workspace: modes,
the record of what was installed, files that nobody accounts for, authorities, and what all enclaves share.
"""

from __future__ import annotations

import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
from functools import partial
from pathlib import Path

from cryptography import x509

from keymint.api import Artifact, BuildOptions, Inspection, Package
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.pki import certificates, keys
from keymint.plan import install
from keymint.plan.authorities import in_order, satisfies, trusted_chains
from keymint.plan.inputs import Inputs, LoadedProfile, Sources
from keymint.plan.secrets import password
from keymint.state import digest
from keymint.workspace import packages


def check(
    inputs: Inputs, loaded: LoadedProfile, names: Sequence[str], sources: Sources, within: timedelta
) -> tuple[Diagnostic, ...]:
    """Return all findings on some packages' enclaves, and on the workspace that they come from.

    Args:
        inputs: the workspace.
        loaded: its profile.
        names: names of packages.
        sources: the packages' files.
        within: report what expires within this time.
    """
    findings: list[Diagnostic] = list(_authorities(inputs, loaded, within))
    inspections: dict[str, list[Inspection]] = {}
    for name in names:
        try:
            files = sources.files(inputs, name)
            package = sources.load(inputs, loaded, name, files)
            inspection = _inspection(inputs, loaded, package, within)
        except KeymintError as error:
            findings += error.diagnostics
            continue
        if not inspection.files:
            findings.append(
                Diagnostic(
                    "enclave-missing",
                    Severity.ERROR,
                    f"the enclave /{name} is not installed",
                    Origin(inspection.folder),
                    f"run 'keymint install {name}'",
                    f"/{name}",
                )
            )
            continue
        findings += _on_disk(inputs, loaded, name, inspection.files)
        findings += inputs.plugins.build_type(package.build_type, inputs.package_marker(package.name)).check(inspection)
        inspections.setdefault(package.build_type, []).append(inspection)
    for build_type, together in sorted(inspections.items()):
        findings += inputs.plugins.build_type(build_type).check_all(together)
    findings += (install.orphan_finding(name) for name in install.orphans(inputs, loaded))
    findings += _shared(inputs, loaded)
    return tuple(_unique(findings))


def _unique(findings: Iterable[Diagnostic]) -> Iterator[Diagnostic]:
    yield from dict.fromkeys(findings)


def _inspection(inputs: Inputs, loaded: LoadedProfile, package: Package, within: timedelta) -> Inspection:
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
        files=_installed_files(inputs, folder),
        folder=workspace.shown(folder),
        layout=loaded.profile.layout,
        identity_ca=chains.get(package.identity.issuer, b""),
        permissions_ca=chains.get(package.permissions.issuer, b""),
        now=inputs.now,
        within_days=within / timedelta(days=1),
    )


def _installed_files(inputs: Inputs, folder: Path) -> dict[str, bytes]:
    """Return the enclave's regular files; a link is a finding of its own."""
    return {
        name: inputs.tree.read(folder / name) or b""
        for name, is_folder in inputs.tree.names(folder)
        if not is_folder and stat.S_ISREG((folder / name).lstat().st_mode)
    }


def _authorities(inputs: Inputs, loaded: LoadedProfile, within: timedelta) -> Iterator[Diagnostic]:
    workspace = inputs.workspace
    issuers: dict[str, x509.Certificate] = {}
    for authority in in_order(loaded.profile.authorities):
        key_path, path = (
            workspace.authority_key(authority.name),
            workspace.authority_certificate(authority.name),
        )
        where = Origin(workspace.shown(path))
        yield from _modes(workspace.shown(key_path.parent), key_path.parent, 0o700, "")
        yield from _modes(workspace.shown(key_path), key_path, 0o600, "")
        pem, key_pem = inputs.tree.read(path), inputs.tree.read(key_path)
        if pem is None:
            yield Diagnostic(
                "authority-missing",
                Severity.ERROR,
                f"the authority {authority.name!r} has no certificate",
                where,
                "run 'keymint install'",
            )
            continue
        if key_pem is None:
            yield Diagnostic(
                "authority-key-missing",
                Severity.NOTE,
                f"the private key of {authority.name!r} is not here",
                where,
                "restore it to sign anything anew",
            )
        yield from _authority(inputs, authority.name, pem, key_pem, issuers, within, loaded)


def _authority(
    inputs: Inputs,
    name: str,
    pem: bytes,
    key_pem: bytes | None,
    issuers: dict[str, x509.Certificate],
    within: timedelta,
    loaded: LoadedProfile,
) -> Iterator[Diagnostic]:
    spec = next(a.certificate for a in loaded.profile.authorities if a.name == name)
    where = Origin(inputs.workspace.shown(inputs.workspace.authority_certificate(name)))
    try:
        certificate = certificates.load(pem)
        key = certificates.public_key(certificate)
    except KeymintError as error:
        yield from (Diagnostic(d.code, d.severity, d.message, where, d.help) for d in error.diagnostics)
        return
    issuers[name] = certificate
    if key_pem is not None:
        try:
            key = keys.from_pem(key_pem, password(spec.key, inputs.environment, spec.origin)).public_key()
        except KeymintError as error:
            yield from map(partial(_about_key, where=where), error.diagnostics)
    end = certificate.not_valid_after_utc
    if not satisfies(pem, spec, key, issuers.get(spec.issuer)):
        yield Diagnostic(
            "authority-drift",
            Severity.ERROR,
            f"the certificate of {name!r} is not what the profile asks for",
            where,
            "run 'keymint install', and deploy all enclaves anew",
        )
    if end < inputs.now:
        yield Diagnostic(
            "authority-expired",
            Severity.ERROR,
            f"the certificate of {name!r} expired on {end:%Y-%m-%d %H:%M} UTC",
            where,
            f"extend its validity at {spec.origin}, and install anew",
        )
    elif end < inputs.now + within:
        yield Diagnostic(
            "authority-expires",
            Severity.WARNING,
            f"the certificate of {name!r} expires on {end:%Y-%m-%d %H:%M} UTC",
            where,
            f"extend its validity at {spec.origin}, and install anew",
        )


def _about_key(found: Diagnostic, where: Origin) -> Diagnostic:
    """Return what is wrong with an authority's key as a finding; that its password is not here is no defect of it."""
    severity = Severity.NOTE if found.code == "password-missing" else found.severity
    return Diagnostic(found.code, severity, found.message, where, found.help)


def _modes(shown: str, path: Path, mode: int, subject: str) -> Iterator[Diagnostic]:
    try:
        found = path.lstat().st_mode
    except OSError:
        return
    if stat.S_ISLNK(found):
        yield Diagnostic(
            "file-link",
            Severity.ERROR,
            "is a symbolic link, and breaks when the enclave is copied",
            Origin(shown),
            "remove it and install anew",
            subject,
        )
    elif stat.S_IMODE(found) != mode:
        yield Diagnostic(
            "file-mode",
            Severity.ERROR if stat.S_IMODE(found) & ~mode & 0o077 else Severity.WARNING,
            f"has mode {stat.S_IMODE(found):04o}, expected {mode:04o}",
            Origin(shown),
            f"chmod {mode:o} {shown}",
            subject,
        )


def _on_disk(inputs: Inputs, loaded: LoadedProfile, name: str, files: Mapping[str, bytes]) -> Iterator[Diagnostic]:
    """Judge modes, links and recorded digests of one enclave."""
    workspace = inputs.workspace
    folder = workspace.enclaves(loaded.profile.layout) / name
    stamp = inputs.state.stamp(install.STAGE, name)
    secret = stamp.secret if stamp else ("key.pem",)
    yield from _modes(workspace.shown(folder), folder, 0o700, f"/{name}")
    for file, is_folder in inputs.tree.names(folder):
        if not is_folder:
            mode = 0o600 if file in secret else 0o644
            yield from _modes(workspace.shown(folder / file), folder / file, mode, f"/{name}")
    yield from _modes(workspace.shown(workspace.identity_key(name)), workspace.identity_key(name), 0o600, f"/{name}")
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


def _shared(inputs: Inputs, loaded: LoadedProfile) -> Iterator[Diagnostic]:
    """Judge what lies in the install space outside of the enclaves."""
    workspace, layout = inputs.workspace, loaded.profile.layout
    enclaves = {workspace.enclaves(layout) / name for name in install.installed(inputs, loaded)}
    expected: dict[str, bytes] = {}
    known = set(packages(inputs.tree, workspace.src))
    artifacts = {
        f"/{folder.relative_to(workspace.enclaves(layout))}": {
            name: Artifact(content) for name, content in _installed_files(inputs, folder).items()
        }
        for folder in enclaves
        if str(folder.relative_to(workspace.enclaves(layout))) in known
    }
    for info in inputs.plugins.infos:
        if info.group == "keymint.build_types" and artifacts:
            shared = inputs.plugins.build_type(info.name).shared(artifacts, layout)
            expected |= {path: artifact.content for path, artifact in shared.items()}
    for path in _files_below(inputs, workspace.install):
        relative = str(path.relative_to(workspace.install))
        if path.parent in enclaves:
            continue
        if relative not in expected:
            yield Diagnostic(
                "file-unexpected",
                Severity.WARNING,
                "is in the install space, but Keymint did not put it there",
                Origin(workspace.shown(path)),
                "remove it",
            )
        else:
            yield from _modes(workspace.shown(path), path, 0o644, "")
            if not path.is_symlink() and inputs.tree.read(path) != expected[relative]:
                yield Diagnostic(
                    "file-changed",
                    Severity.ERROR,
                    "differs from what the enclaves hold",
                    Origin(workspace.shown(path)),
                    "'keymint install' restores it",
                )
    for relative in expected:
        if not (workspace.install / relative).exists():
            yield Diagnostic(
                "file-missing",
                Severity.ERROR,
                "is missing",
                Origin(workspace.shown(workspace.install / relative)),
                "'keymint install' restores it",
            )


def _files_below(inputs: Inputs, folder: Path) -> Iterator[Path]:
    for name, is_folder in inputs.tree.names(folder):
        if is_folder:
            yield from _files_below(inputs, folder / name)
        else:
            yield folder / name
