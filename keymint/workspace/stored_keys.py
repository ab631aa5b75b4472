# SPDX-License-Identifier: Apache-2.0
"""Load stored private keys, with their passwords, if their kind is the specified one; record which keys are in use."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

from comarmor.values import replace
from keymint.api import CertificateSpec
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.pki import certificates, keys
from keymint.view.stamps import Stamps, State, row_of_inputs
from keymint.workspace.installed_enclaves import INSTALLED, installed_certificate
from keymint.workspace.session import Inputs, Session

_Key = TypeVar("_Key", bound=keys.PrivateKey | keys.PublicKey)
MAX_PASSWORD = 1023
"""Bytes of a password that OpenSSL can read (PEM_BUFSIZE, less the final null)."""


def password(inputs: Inputs, spec: CertificateSpec) -> bytes | None:
    """Return the password of the key of a certificate, or None for a key that is stored unencrypted.

    Raises:
        KeymintError: the variable is not set, or empty, or its value is too long.
    """
    variable = spec.key.password_env
    if not variable:
        return None
    value = inputs.environment.get(variable, "")
    if not value:
        message = f"the environment variable {variable}, which holds the key's password, is not set"
        raise KeymintError(message, where=spec.origin, help=f"export {variable}=…", code="password-missing")
    secret = os.fsencode(value)  # the bytes of the environment, which need not be UTF-8
    if len(secret) > MAX_PASSWORD:
        raise KeymintError(
            f"the environment variable {variable} holds a password of {len(secret):,} bytes, expected at most "
            f"{MAX_PASSWORD:,}",
            where=spec.origin,
            help="choose a shorter one, which OpenSSL can read",
            code="password-long",
        )
    return secret


def load_key(
    inputs: Inputs,
    read: Callable[[bytes, bytes | None, Origin], _Key],
    pem: bytes,
    spec: CertificateSpec,
    shown: Origin,
    remedy: str,
) -> _Key:
    """Load a stored private key, or its public key.

    Args:
        inputs: the workspace.
        read: :func:`keymint.pki.keys.from_pem`, or :func:`keymint.pki.keys.public_of` for the public key.
        pem: the file's bytes.
        spec: the certificate whose key the sources specify.
        shown: the file, for messages.
        remedy: how to fix a key that cannot be used, for messages.

    Raises:
        KeymintError: the file is damaged, the password is wrong or missing, or the key is not of the specified kind;
            keys are replaced only on request.
    """
    try:
        key = read(pem, password(inputs, spec) if keys.is_encrypted(pem) else None, shown)
    except KeymintError as error:
        raise KeymintError.of(replace(each, help=_help(each, spec, remedy)) for each in error.diagnostics) from None
    if not keys.fits(key, spec.key):
        message = f"is not {keys.key_description(spec.key)}, which {spec.origin} asks for"
        raise KeymintError(message, where=shown, help=remedy, code="key-kind")
    return key


def key_defects(error: KeymintError, subject: str = "") -> Iterator[Diagnostic]:
    """Yield the defects of a stored key as findings; a missing password is only a note."""
    for defect in error.diagnostics:
        severity = Severity.NOTE if defect.code == "password-missing" else defect.severity
        yield replace(defect, severity=severity, subject=subject)


def _help(diagnostic: Diagnostic, spec: CertificateSpec, remedy: str) -> str:
    """Return how to fix a key that cannot be read."""
    if diagnostic.code == "key-invalid":
        return remedy
    variable = spec.key.password_env
    if diagnostic.code == "key-password" and not variable:
        return f"name the environment variable of its password in password_env at {spec.origin}"
    if diagnostic.code == "key-password":
        return f"set {variable} to the password that the file was encrypted with, or {remedy}"
    return diagnostic.help


AUTHORITY_KEYS = "authority-keys"
IDENTITY_KEYS = "identity-keys"


def recorded_key(state: State, stage: str, name: str) -> str:
    """Return the fingerprint of the key that the record has for an authority or a package, or an empty text."""
    stamp = state.stamp(stage, name)
    return stamp.inputs if stamp else ""


def with_recorded_keys(state: State, stage: str, fingerprints: Mapping[str, str]) -> State:
    """Return the state with these keys on record; unchanged if they already are."""
    recorded = Stamps.of(state.stamps.get(stage, {})).rows
    rows = {name: row_of_inputs(value) for name, value in fingerprints.items()}
    new = {name: row for name, row in rows.items() if recorded.get(name) != row}
    return state.updated(stage, new) if new else state


def without_recorded_keys(state: State, stage: str, names: tuple[str, ...]) -> State:
    """Return the state without the keys of these authorities or packages."""
    return state.updated(stage, {}, names) if any(recorded_key(state, stage, name) for name in names) else state


def known_fingerprint(session: Session, name: str) -> str:
    """Return the fingerprint of the key that a package's subject has, or an empty text.

    That is the recorded key, or if the record was lost the key of the installed certificate. Before anything is
    installed the subject has none: the user may replace the minted key with one of their own.
    """
    recorded = recorded_key(session.state, IDENTITY_KEYS, name)
    if recorded and name in session.state.stamps.get(INSTALLED, {}):
        return recorded
    certificate = installed_certificate(session, name)
    return (recorded or certificates.fingerprint(certificate)) if certificate else ""


def key_place(inputs: Inputs, name: str) -> Origin:
    """Return the place of a package's stored private key."""
    return inputs.workspace.origin(inputs.workspace.identity_key(name))


def key_remedy(name: str) -> str:
    """Return how to fix the key of a package that cannot be used."""
    restored = f"remove it and run 'keymint build -f {name}' to restore it from the enclave"
    return f"{restored}, or mint a new one with {key_renewal(name)}"


def missing_key_remedy(name: str, *, in_enclave: bool) -> str:
    """Return what the owner of a package without a key can do, whose enclave may have the key."""
    source = f"with 'keymint build -f {name}' from the enclave, which has it," if in_enclave else "from a backup,"
    return f"if it was deleted by mistake, restore it {source} else make a new one with {key_renewal(name)}"


def key_renewal(name: str) -> str:
    """Return the command that makes a new key for a package."""
    return f"'keymint build --rekey {name}'"
