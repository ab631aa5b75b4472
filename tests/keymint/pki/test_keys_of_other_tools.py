# SPDX-License-Identifier: Apache-2.0
"""Private keys are recognised in the forms that openssl writes, and nothing else is taken for one."""

from __future__ import annotations

import pytest

from keymint.api import KeySpec
from keymint.pki import keys

EC = keys.to_pem(keys.generate(KeySpec("ec", "SECP256R1")))
RSA = keys.to_pem(keys.generate(KeySpec("rsa", size=2048)))
READ = {
    "PKCS #8": ("pkey", "-in", "key", "-outform", "DER"),
    "traditional": ("pkey", "-in", "key", "-traditional", "-outform", "DER"),
    "traditional PEM": ("pkey", "-in", "key", "-traditional"),
}
SEALED = {
    "encrypted": ("pkcs8", "-topk8", "-in", "key", "-passout", "pass:x", "-outform", "DER"),
    "encrypted PEM": ("pkcs8", "-topk8", "-in", "key", "-passout", "pass:x"),
    "legacy PEM": ("pkey", "-in", "key", "-traditional", "-aes128", "-passout", "pass:x"),
    "PKCS #12": ("pkcs12", "-export", "-inkey", "key", "-nocerts", "-passout", "pass:x"),
    "PKCS #12 in clear": ("pkcs12", "-export", "-inkey", "key", "-nocerts", "-keypbe", "NONE", "-nomac",
                          "-passout", "pass:"),
}  # fmt: skip


def written(openssl, pem: bytes, *arguments: str) -> bytes:
    openssl.put(key=pem)
    openssl.accepts(*arguments, "-out", "written")
    return (openssl.folder / "written").read_bytes()


@pytest.mark.parametrize("pem", [EC, RSA], ids=["ec", "rsa"])
@pytest.mark.parametrize("form", READ)
def test_a_key_that_can_be_read(openssl, pem: bytes, form: str) -> None:
    content = written(openssl, pem, *READ[form])
    public = keys.public_of(pem)
    for each in (content, content + b"\n"):
        assert keys.has_private_key(each)
        assert keys.private_keys(each) == ((public,), False)
        assert keys.public_of(keys.pem_of(each, public)) == public


@pytest.mark.parametrize("pem", [EC, RSA], ids=["ec", "rsa"])
@pytest.mark.parametrize("form", SEALED)
def test_a_key_that_cannot_be_read(openssl, pem: bytes, form: str) -> None:
    content = written(openssl, pem, *SEALED[form])
    assert keys.has_private_key(content)
    assert keys.private_keys(content) == ((), True)


def test_several_keys_in_one_file(openssl) -> None:
    sealed = written(openssl, EC, *SEALED["encrypted PEM"])
    found = keys.private_keys(b"text\r\n" + EC + sealed + RSA.replace(b"\n", b"\r\n"))
    assert found == ((keys.public_of(EC), keys.public_of(RSA)), True)
    assert keys.public_of(keys.pem_of(EC + RSA, keys.public_of(RSA))) == keys.public_of(RSA)


def test_a_key_of_another_kind(openssl) -> None:
    for form in ((), ("-outform", "DER")):
        openssl.accepts("genpkey", "-algorithm", "ed25519", *form, "-out", "written")
        content = (openssl.folder / "written").read_bytes()
        assert keys.has_private_key(content)
        assert keys.private_keys(content) == ((), False)


@pytest.mark.parametrize(
    "arguments",
    [("pkey", "-in", "key", "-pubout", "-outform", "DER"), ("pkey", "-in", "key", "-pubout"),
     ("req", "-x509", "-new", "-key", "key", "-subj", "/CN=x", "-outform", "DER")],
    ids=["public", "public PEM", "certificate"],
)  # fmt: skip
def test_what_is_no_private_key(openssl, arguments: tuple[str, ...]) -> None:
    content = written(openssl, EC, *arguments)
    assert not keys.has_private_key(content)
    for damaged in (content, content[:40], b"\x30", b"", b"\x30\x80\x02\x01\x03"):
        assert keys.private_keys(damaged) == ((), False)
