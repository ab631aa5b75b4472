# SPDX-License-Identifier: Apache-2.0
"""The floor: the least work that provisions N enclaves, with bare ``cryptography`` calls.

A key, a certificate, one S/MIME signature and six files per enclave; no policy, no validation, no safe writing. And the
least work that puts the files of a workspace on a disk.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from multiprocessing import get_context
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

_DAY = timedelta(days=1)


def _certificate(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    issuer: str,
    issuer_key: ec.EllipticCurvePrivateKey,
    *extensions: tuple[x509.ExtensionType, bool],
) -> x509.Certificate:
    """Return a certificate that is valid for a year; each extension with whether it is critical."""
    subject, issuing = (x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, each)]) for each in (name, issuer))
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuing).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(now - _DAY).not_valid_after(now + 365 * _DAY)
    for extension, critical in extensions:
        builder = builder.add_extension(extension, critical=critical)
    return builder.sign(issuer_key, hashes.SHA256())


def _authority(name: str) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return a self-signed authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    return _certificate(name, key, name, key, (x509.BasicConstraints(ca=True, path_length=None), True)), key


def provision(folder: Path, names: list[str], permissions: bytes) -> None:
    """Write one enclave for each name into a folder.

    Args:
        folder: an empty folder.
        names: names of the enclaves.
        permissions: the unsigned permissions document, here the same for all.
    """
    ca, ca_key = _authority("identity_ca")
    notary, notary_key = _authority("permissions_ca")
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    ca_pem, notary_pem = ca.public_bytes(encoding), notary.public_bytes(encoding)
    of_node = (
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), False),
    )
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    for name in names:
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(name, key, "identity_ca", ca_key, *of_node)
        signer = pkcs7.PKCS7SignatureBuilder().set_data(permissions).add_signer(notary, notary_key, hashes.SHA256())
        files = {
            "permissions.p7s": signer.sign(serialization.Encoding.SMIME, options),
            "permissions.xml": permissions,
            "cert.pem": certificate.public_bytes(encoding),
            "key.pem": key.private_bytes(encoding, form, serialization.NoEncryption()),
            "identity_ca.cert.pem": ca_pem,
            "permissions_ca.cert.pem": notary_pem,
        }
        enclave = folder / name
        enclave.mkdir(parents=True)
        for file, content in files.items():
            (enclave / file).write_bytes(content)


def content(folder: Path) -> Sequence[tuple[str, Mapping[str, bytes]]]:
    """Return the folders below one that have files, each with these."""
    below = sorted((path.relative_to(folder).as_posix(), path) for path in folder.rglob("*") if path.is_dir())
    found = [
        (name, {file.name: file.read_bytes() for file in path.iterdir() if file.is_file()}) for name, path in below
    ]
    return [(name, files) for name, files in found if files]


def write(folder: Path, folders: Sequence[tuple[str, Mapping[str, bytes]]]) -> None:
    """Write folders and files below a new folder by two processes, each a half, and synchronise them once."""
    half = len(folders) // 2
    other = get_context("fork").Process(target=_write, args=(folder, folders[half:]))
    other.start()
    _write(folder, folders[:half])
    other.join()
    if other.exitcode:
        raise RuntimeError(f"the files of {folder} were not all written")
    os.sync()


def _write(folder: Path, folders: Sequence[tuple[str, Mapping[str, bytes]]]) -> None:
    for name, files in folders:
        place = folder / name
        place.mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (place / file).write_bytes(text)
