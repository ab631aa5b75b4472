# SPDX-License-Identifier: Apache-2.0
"""The private keys of a workspace, in all forms in which they could leave it."""

from __future__ import annotations

from pathlib import Path

from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)


def key_material(workspace: Path) -> dict[str, bytes]:
    """Return lines of PEM, DER and the secret numbers of all private keys, by the name of their file and a number."""
    secrets: dict[str, bytes] = {"any key": b"PRIVATE KEY"}
    for file in sorted(workspace.rglob("*")):
        content = file.read_bytes() if file.is_file() else b""
        if b"PRIVATE KEY-----" not in content:
            continue
        key = load_pem_private_key(content, None)
        der = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
        number = key.private_numbers().private_value
        size = (number.bit_length() + 7) // 8
        lines = [line for line in content.splitlines() if not line.startswith(b"-----")]
        forms = (*lines, der, number.to_bytes(size, "big"), number.to_bytes(size, "little"), str(number).encode())
        secrets |= {f"{file} {at}": form for at, form in enumerate(forms)}
    return secrets
