# SPDX-License-Identifier: Apache-2.0
"""Load stored private keys: read their passwords, and check that their kind is the specified one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import KeySpec
from keymint.errors import KeymintError
from keymint.pki import keys

_Key = TypeVar("_Key", bound=keys.PrivateKey | keys.PublicKey)
MAX_PASSWORD = 1023
"""Bytes of a password that OpenSSL can read (PEM_BUFSIZE, less the final null)."""


def password(spec: KeySpec, environment: Mapping[str, str], origin: Origin) -> bytes | None:
    """Return the password of a key, or None for a key that is stored unencrypted.

    Raises:
        KeymintError: the variable is not set, or empty, or its value is too long.
    """
    if not spec.password_env:
        return None
    value = environment.get(spec.password_env, "")
    if not value:
        raise KeymintError(
            f"the environment variable {spec.password_env}, which holds the key's password, is not set",
            where=origin,
            help=f"export {spec.password_env}=…",
            code="password-missing",
        )
    secret = os.fsencode(value)  # the bytes of the environment, which need not be UTF-8
    if len(secret) > MAX_PASSWORD:
        raise KeymintError(
            f"the environment variable {spec.password_env} holds a password of {len(secret):,} bytes, "
            f"expected at most {MAX_PASSWORD:,}",
            where=origin,
            help="choose a shorter one, which OpenSSL can read",
            code="password-long",
        )
    return secret


def load_key(
    read: Callable[[bytes, bytes | None, Origin], _Key],
    pem: bytes,
    spec: KeySpec,
    environment: Mapping[str, str],
    shown: Origin,
    asked: Origin,
    remedy: str,
) -> _Key:
    """Load a stored private key, or its public key.

    Args:
        read: :func:`keymint.pki.keys.from_pem`, or :func:`keymint.pki.keys.public_of` for the public key.
        pem: the file's bytes.
        spec: the kind of key that the sources specify.
        environment: environment variables, for the password.
        shown: the file, for messages.
        asked: where the sources specify the key.
        remedy: how to fix a key that cannot be used, for messages.

    Raises:
        KeymintError: the file is damaged, the password is wrong or missing, or the key is not of the specified kind;
            keys are replaced only on request.
    """
    try:
        key = read(pem, password(spec, environment, asked), shown)
    except KeymintError as error:
        diagnostics = [replace(each, help=_help(each, spec, asked, remedy)) for each in error.diagnostics]
        raise KeymintError.of(diagnostics) from None
    if not keys.fits(key, spec):
        kind = f"an EC key on {spec.curve}" if spec.algorithm == "ec" else f"an RSA key of {spec.size} bits"
        raise KeymintError(f"is not {kind}, which {asked} asks for", where=shown, help=remedy, code="key-kind")
    return key


def key_defects(error: KeymintError, subject: str = "") -> Iterator[Diagnostic]:
    """Yield the defects of a stored key as findings; a missing password is only a note."""
    for defect in error.diagnostics:
        severity = Severity.NOTE if defect.code == "password-missing" else defect.severity
        yield replace(defect, severity=severity, subject=subject)


def _help(diagnostic: Diagnostic, spec: KeySpec, asked: Origin, remedy: str) -> str:
    """Return how to fix a key that cannot be read."""
    if diagnostic.code == "key-invalid":
        return remedy
    if diagnostic.code == "key-password" and not spec.password_env:
        return f"name the environment variable of its password in password_env at {asked}"
    if diagnostic.code == "key-password":
        return f"set {spec.password_env} to the password that the file was encrypted with, or {remedy}"
    return diagnostic.help
