# SPDX-License-Identifier: Apache-2.0
"""Keys and files of the workspace ``ws``, for tests of keys and authorities."""

from __future__ import annotations

from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from keymint.api import KeySpec
from keymint.pki import keys
from tests.conftest import snapshot

CERTIFICATES = ("public/identity_ca.cert.pem", "public/permissions_ca.cert.pem")


AUTHORITY_KEYS = ("private/identity_ca.key.pem", "private/permissions_ca.key.pem")


IDENTITY_KEYS = ("private/identities/talker/key.pem", "private/identities/robot1/listener/key.pem")


ENCLAVES = ("talker", "robot1/listener")


def public_key(path: Path) -> bytes:
    """The public key of a file with a certificate or an unencrypted private key."""
    content = path.read_bytes()
    if b"CERTIFICATE" in content:
        key = x509.load_pem_x509_certificates(content)[0].public_key()
    else:
        key = load_pem_private_key(content, None).public_key()
    return key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def trusted(ws: Path) -> dict[str, bytes]:
    """The keys that the installed enclaves trust and have."""
    names = ("identity_ca.cert.pem", "permissions_ca.cert.pem", "cert.pem", "key.pem")
    return {
        f"{enclave}/{name}": public_key(ws / "install/enclaves" / enclave / name)
        for enclave in ENCLAVES
        for name in names
    }


def content(ws: Path) -> dict[str, bytes]:
    """Return the files of a workspace, without what is recorded of runs."""
    recorded = (".keymint", "private/runs.jsonl")
    return {name: data for name, (_, _, data) in snapshot(ws).items() if not name.startswith(recorded)}


def another_key(_ws: Path, path: Path) -> None:
    path.write_bytes(keys.to_pem(keys.generate(KeySpec("ec", "SECP256R1"))))
