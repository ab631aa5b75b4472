# SPDX-License-Identifier: Apache-2.0
"""Public keys of subjects whose private keys are elsewhere."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki import public_keys
from keymint.pki.keys import PrivateKey


@pytest.mark.parametrize(
    "key",
    [
        ec.derive_private_key(5, ec.SECP256R1()),
        ec.derive_private_key(5, ec.SECP384R1()),
        rsa.generate_private_key(65537, 2048),
    ],
)
def test_what_is_written_is_read_back(key: PrivateKey) -> None:
    pem = public_keys.to_pem(key.public_key())
    assert pem.startswith(b"-----BEGIN PUBLIC KEY-----\n")
    assert public_keys.from_pem(pem) == key.public_key()


@pytest.mark.parametrize(
    "pem",
    [
        b"",
        b"\xff",
        ed25519.Ed25519PrivateKey.generate()
        .public_key()
        .public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo),
        ec.derive_private_key(5, ec.SECP256R1()).private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        ),
    ],
    ids=["nothing", "no text", "another algorithm", "a private key"],
)
def test_anything_else_is_refused_at_its_place(pem: bytes) -> None:
    with pytest.raises(KeymintError, match="not an EC or RSA public key") as error:
        public_keys.from_pem(pem, Origin("issuance.xml", 4))
    assert str(error.value.diagnostics[0]).startswith("issuance.xml:4")
    assert error.value.diagnostics[0].code == "public-key-invalid"
