# SPDX-License-Identifier: Apache-2.0
"""Signs documents as other tools do: ``openssl smime``, ``openssl cms``, and SROS2, which uses ``cryptography``."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.serialization import pkcs7

from keymint.pki import certificates, keys, smime

Sign = Callable[[bytes, x509.Certificate, keys.PrivateKey], bytes]
HAVE_OPENSSL = shutil.which("openssl") is not None


def by_openssl(
    content: bytes, certificate: x509.Certificate, key: keys.PrivateKey, command: str = "smime", *options: str
) -> bytes:
    """Sign as ``openssl smime -sign -text`` or ``openssl cms -sign -text`` does."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "ca.pem").write_bytes(certificates.to_pem(certificate))
        (folder / "key.pem").write_bytes(keys.to_pem(key))
        (folder / "in.xml").write_bytes(content)
        asked = ("-text", "-in", "in.xml", "-out", "out", "-signer", "ca.pem", "-inkey", "key.pem", *options)
        subprocess.run(["openssl", command, "-sign", *asked], cwd=folder, check=True, capture_output=True)
        return (folder / "out").read_bytes()


def by_sros2(
    content: bytes,
    certificate: x509.Certificate,
    key: keys.PrivateKey,
    digest: type[hashes.SHA256 | hashes.SHA384 | hashes.SHA512] = hashes.SHA256,
    *more: pkcs7.PKCS7Options,
) -> bytes:
    """Sign as ``ros2 security`` does: ``_utilities.create_smime_signed_file``."""
    builder = pkcs7.PKCS7SignatureBuilder().set_data(content).add_signer(certificate, key, digest())
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature, *more]
    return builder.sign(serialization.Encoding.SMIME, options)


def _openssl(command: str, *options: str) -> Sign:
    return lambda content, certificate, key: by_openssl(content, certificate, key, command, *options)


SIGNERS: Mapping[str, Sign] = {
    "keymint": smime.sign,
    "openssl-smime": _openssl("smime"),
    "openssl-smime-crlf": _openssl("smime", "-crlfeol"),
    "openssl-smime-sha384": _openssl("smime", "-md", "sha384"),
    "openssl-smime-sha512": _openssl("smime", "-md", "sha512"),
    "openssl-cms": _openssl("cms"),
    "sros2": by_sros2,
    "sros2-sha512": lambda content, certificate, key: by_sros2(content, certificate, key, hashes.SHA512),
    "sros2-bare": lambda *signed: by_sros2(*signed, hashes.SHA256, pkcs7.PKCS7Options.NoCapabilities),
}
"""Signers whose output every vendor accepts, by name."""
