# SPDX-License-Identifier: Apache-2.0
"""Requests prove the possession of a key; openssl reads and verifies them."""

from __future__ import annotations

import base64
import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import AttributeOID, NameOID

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.robots import certification_request

from .conftest import NONCE, authority, robot_key, spec

WHERE = Origin("talker.request.pem")


def csr(name: str = "/talker", nonce: str | None = NONCE, key: object = None, more: tuple = ()) -> bytes:
    key = key or robot_key("talker")
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name), *more])
    builder = x509.CertificateSigningRequestBuilder(subject)
    if nonce is not None:
        builder = builder.add_attribute(AttributeOID.CHALLENGE_PASSWORD, nonce.encode())
    digest = None if isinstance(key, ed25519.Ed25519PrivateKey) else hashes.SHA256()
    return builder.sign(key, digest).public_bytes(Encoding.PEM)


def current(name: str = "old") -> certificates.Issuer:
    """Return the present certificate and key of an enclave."""
    key = robot_key(name)
    issued = certificates.issue(spec("CN=/talker"), key.public_key(), authority(), authority=False)
    return certificates.Issuer(issued.certificate, key)


def code(content: bytes) -> str:
    with pytest.raises(KeymintError) as refused:
        certification_request.read(content, WHERE)
    [diagnostic] = refused.value.diagnostics
    assert diagnostic.where == WHERE
    assert diagnostic.help
    return diagnostic.code


def test_what_is_made_is_read() -> None:
    key = robot_key("talker")
    read = certification_request.read(certification_request.make("/talker", key, NONCE), WHERE)
    assert (read.common_name, read.nonce, read.signer) == ("/talker", NONCE, "")
    assert read.fingerprint == keys.fingerprint(key)
    assert b"BEGIN PUBLIC KEY" in read.public_key


def test_an_rsa_key_may_be_requested() -> None:
    key = rsa.generate_private_key(65537, 2048)
    assert certification_request.read(
        certification_request.make("/talker", key, NONCE), WHERE
    ).fingerprint == keys.fingerprint(key)


def test_the_current_key_may_sign_too() -> None:
    read = certification_request.read(certification_request.make("/talker", robot_key("new"), NONCE, current()), WHERE)
    assert read.fingerprint == keys.fingerprint(robot_key("new"))
    assert read.signer == keys.fingerprint(robot_key("old"))


def test_the_signature_of_the_current_key_is_of_this_request_only() -> None:
    vouched = certification_request.make("/talker", robot_key("new"), NONCE, current())
    other = certification_request.make("/talker", robot_key("swapped"), NONCE)
    assert code(other + vouched[vouched.index(b"-----BEGIN CMS") :]) == "request-signature"


def test_a_damaged_signature_of_the_current_key() -> None:
    made = certification_request.make("/talker", robot_key("new"), NONCE)
    block = b"-----BEGIN CMS-----\n" + base64.b64encode(b"no signature") + b"\n-----END CMS-----\n"
    assert code(made + block) == "request-invalid"


def test_proof_of_possession() -> None:
    made, other = (certification_request.make("/talker", robot_key(name), NONCE) for name in ("talker", "other"))
    der = base64.b64decode(b"".join(made.split(b"\n")[1:-2]))
    point = x509.load_pem_x509_csr(made).public_key().public_numbers()
    swapped = x509.load_pem_x509_csr(other).public_key().public_numbers()
    der = der.replace(point.x.to_bytes(32, "big"), swapped.x.to_bytes(32, "big"))
    der = der.replace(point.y.to_bytes(32, "big"), swapped.y.to_bytes(32, "big"))
    lines = base64.b64encode(der)
    wrapped = b"\n".join(lines[at : at + 64] for at in range(0, len(lines), 64))
    pem = b"-----BEGIN CERTIFICATE REQUEST-----\n" + wrapped + b"\n-----END CERTIFICATE REQUEST-----\n"
    assert code(pem) == "request-signature"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "request-invalid"),
        (b"x" * 100, "request-invalid"),
        (csr() * 2, "request-invalid"),
        (b"text\n" + csr(), "request-invalid"),
        (csr() + b"\n", "request-invalid"),
        (csr().replace(b"\n", b"\r\n"), "request-invalid"),
        (csr() + b"-----BEGIN JUNK-----\n" * 10_000, "request-invalid"),
        (certificates.to_pem(authority().certificate), "request-invalid"),
        (csr(nonce=None), "request-invalid"),
        (csr(nonce="short"), "request-invalid"),
        (csr(name="/../etc"), "request-invalid"),
        (csr(name="/a b"), "request-invalid"),
        (csr(more=(x509.NameAttribute(NameOID.ORGANIZATION_NAME, "x"),)), "request-invalid"),
        (csr(key=ec.generate_private_key(ec.SECP256K1())), "key-kind"),
        (csr(key=ed25519.Ed25519PrivateKey.generate()), "key-kind"),
        (csr(key=rsa.generate_private_key(65537, 1024)), "key-kind"),
    ],
)
def test_what_is_refused(content: bytes, expected: str) -> None:
    assert code(content) == expected


def test_every_altered_byte_is_noticed() -> None:
    made = certification_request.make("/talker", robot_key("new"), NONCE, current())
    read = certification_request.read(made, WHERE)
    block = made.index(b"-----BEGIN CMS")
    for at in range(0, len(made), 7):
        altered = bytearray(made)
        altered[at] ^= 1
        try:
            assert certification_request.read(bytes(altered), WHERE) == read
        except KeymintError:
            continue
        # Of the certificate of the current key nothing matters but that key.
        assert at > block, f"byte {at} does not matter"


def test_extensions_are_ignored() -> None:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "/talker")])
    builder = x509.CertificateSigningRequestBuilder(subject)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    builder = builder.add_attribute(AttributeOID.CHALLENGE_PASSWORD, NONCE.encode())
    asked = builder.sign(robot_key("talker"), hashes.SHA256()).public_bytes(Encoding.PEM)
    plain = certification_request.read(certification_request.make("/talker", robot_key("talker"), NONCE), WHERE)
    assert certification_request.read(asked, WHERE) == plain


@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
def test_openssl_verifies_a_request(tmp_path: Path) -> None:
    made = certification_request.make("/talker", robot_key("new"), NONCE, current())
    (tmp_path / "talker.request.pem").write_bytes(made)
    command = ["openssl", "req", "-in", "talker.request.pem", "-noout", "-verify", "-subject", "-text"]
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "verify OK" in shown.stdout + shown.stderr
    assert "CN = /talker" in shown.stdout
    assert NONCE in shown.stdout
    block = made[: made.index(b"-----BEGIN CMS")]
    (tmp_path / "content").write_bytes(block)
    (tmp_path / "signature.pem").write_bytes(made[len(block) :])
    (tmp_path / "ca.pem").write_bytes(certificates.to_pem(authority().certificate))
    asked = ["openssl", "cms", "-verify", "-binary", "-inform", "PEM", "-in", "signature.pem", "-content", "content"]
    subprocess.run([*asked, "-CAfile", "ca.pem", "-purpose", "any", "-no_check_time"], cwd=tmp_path, check=True)
