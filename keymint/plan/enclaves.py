"""The enclaves in the install space, as they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cryptography import x509

from keymint.errors import Diagnostic, KeymintError, Severity
from keymint.pki import certificates
from keymint.plan.inputs import Inputs, LoadedProfile
from keymint.workspace import packages

CERTIFICATE, KEY = "cert.pem", "key.pem"


def installed(inputs: Inputs, loaded: LoadedProfile) -> tuple[str, ...]:
    """Return the names of the installed enclaves, sorted."""
    found: list[str] = []

    def search(folder: Path, name: str) -> None:
        entries = inputs.tree.names(folder)
        if name and any(entry in {KEY, CERTIFICATE} for entry, is_folder in entries if not is_folder):
            found.append(name)
        for entry, is_folder in entries:
            if is_folder and not entry.startswith("."):
                search(folder / entry, f"{name}/{entry}" if name else entry)

    search(inputs.workspace.enclaves(loaded.profile.layout), "")
    return tuple(sorted(found))


def orphans(inputs: Inputs, loaded: LoadedProfile) -> tuple[str, ...]:
    """Return the installed enclaves that have no source package, sorted."""
    known = set(packages(inputs.tree, inputs.workspace.src))
    return tuple(name for name in installed(inputs, loaded) if name not in known)


def orphan_finding(name: str) -> Diagnostic:
    """Return the finding on an installed enclave without a source package."""
    return Diagnostic(
        "enclave-orphaned",
        Severity.WARNING,
        f"the enclave /{name} is installed, but has no source package",
        None,
        "'keymint install --prune' removes it",
        f"/{name}",
    )


def deployed_authorities(inputs: Inputs, loaded: LoadedProfile) -> tuple[x509.Certificate, ...]:
    """Return the certificates of authorities that the installed enclaves trust, each once.

    A file that cannot be read, or that holds no certificates, says nothing about any authority.
    """
    found: dict[bytes, None] = {}
    root = inputs.workspace.enclaves(loaded.profile.layout)
    for name in installed(inputs, loaded):
        for entry, is_folder in inputs.tree.names(root / name):
            if not is_folder and entry.endswith(".pem") and entry not in {CERTIFICATE, KEY}:
                found[_content(inputs, root / name / entry)] = None
    return tuple(dict.fromkeys(certificate for pem in found for certificate in _certificates(pem)))


def installed_certificate(inputs: Inputs, loaded: LoadedProfile, name: str) -> x509.Certificate | None:
    """Return the identity certificate of an installed enclave, or None when there is none that can be read."""
    path = inputs.workspace.enclaves(loaded.profile.layout) / name / CERTIFICATE
    return next(_certificates(_content(inputs, path)), None)


def _content(inputs: Inputs, path: Path) -> bytes:
    try:
        return inputs.tree.read(path) or b""
    except KeymintError:
        return b""


def _certificates(pem: bytes) -> Iterator[x509.Certificate]:
    try:
        for certificate in certificates.load_bundle(pem) if pem else ():
            certificates.public_key(certificate)
            yield certificate
    except KeymintError:
        return
