# SPDX-License-Identifier: Apache-2.0
"""Specifications of certificates, and the openssl command that judges what we emit."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pytest

from comarmor.errors import Origin
from keymint.api import CertificateSpec, Extension, KeySpec, Validity
from keymint.pki import certificates, keys

P256 = KeySpec("ec", "SECP256R1")
ORIGIN = Origin("profile/authorities.xml", 7)


def period(first: int, last: int) -> Validity:
    return Validity(datetime(first, 1, 1, tzinfo=UTC), datetime(last, 1, 1, tzinfo=UTC))


def make_spec(
    subject: str = "CN=ca",
    *,
    validity: Validity | None = None,
    serial: int | None = None,
    hash_algorithm: str = "SHA256",
    key: KeySpec = P256,
    **extensions: str,
) -> CertificateSpec:
    """Return a specification; an extension's value may begin with ``critical,``."""
    listed = tuple(
        Extension(name, value, False, Origin("profile/authorities.xml", 20 + line))
        for line, (name, value) in enumerate(extensions.items())
    )
    return CertificateSpec(subject, validity or period(2020, 2040), serial, "", hash_algorithm, key, listed, ORIGIN)


@dataclass(frozen=True)
class Openssl:
    """Runs openssl in a folder into which PEM files are put by name."""

    folder: Path

    def put(self, **files: bytes) -> None:
        for name, content in files.items():
            (self.folder / name).write_bytes(content)

    def run(self, *arguments: str) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(["openssl", *arguments], cwd=self.folder, capture_output=True, check=False)

    def accepts(self, *arguments: str) -> None:
        done = self.run(*arguments)
        assert done.returncode == 0, (arguments, done.stdout, done.stderr)

    def refuses(self, *arguments: str) -> bytes:
        done = self.run(*arguments)
        assert done.returncode != 0, (arguments, done.stdout, done.stderr)
        return done.stderr


@pytest.fixture
def openssl(tmp_path: Path) -> Openssl:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed: apt-get install openssl")
    return Openssl(tmp_path)


@pytest.fixture
def spec() -> Callable[..., CertificateSpec]:
    return make_spec


@pytest.fixture(scope="session")
def authority() -> certificates.Issuer:
    """A self-signed P-256 authority, valid 2020 to 2040."""
    key = keys.generate(P256)
    return certificates.Issuer(
        certificates.issue(make_spec("CN=permissions ca"), key.public_key(), key, authority=True).certificate, key
    )


@pytest.fixture(scope="session")
def other() -> certificates.Issuer:
    """Another authority with the same name and another key."""
    key = keys.generate(P256)
    return certificates.Issuer(
        certificates.issue(make_spec("CN=permissions ca"), key.public_key(), key, authority=True).certificate, key
    )
