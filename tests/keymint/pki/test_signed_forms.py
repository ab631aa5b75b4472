# SPDX-License-Identifier: Apache-2.0
"""One reader of signed files: it takes what Keymint, openssl and SROS2 sign, and only what has exactly one reading."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from comarmor.errors import Origin
from keymint.api import KeySpec
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime
from tests.signers import HAVE_OPENSSL, SIGNERS, by_openssl, by_sros2

CONTENT = (
    b'<?xml version="1.0"?>\n<dds>\n  <topic>rt/chatter</topic>\n\n  trailing  \t\n.\nFrom me\n--\n'
    b"- x\n" + "caf\xe9 \u20ac".encode() + b"\n" + b"x" * 3000 + b"\n</dds>\n\n"
)
OLD = b"<dds>\n  <topic>*</topic>\n</dds>\n"
HERE = Origin("permissions.p7s")
Change = Callable[[bytes], bytes]

pytestmark = pytest.mark.skipif(not HAVE_OPENSSL, reason="openssl is not installed: apt-get install openssl")


def pem(authority: certificates.Issuer) -> bytes:
    return certificates.to_pem(authority.certificate)


@pytest.fixture(scope="module", params=SIGNERS)
def signed(request: pytest.FixtureRequest, authority: certificates.Issuer) -> bytes:
    return SIGNERS[request.param](CONTENT, authority.certificate, authority.key)


@pytest.fixture(scope="module", params=["keymint", "openssl-smime", "sros2"])
def genuine(request: pytest.FixtureRequest, authority: certificates.Issuer) -> tuple[bytes, bytes]:
    """An old and a current document of one signer."""
    old, current = (SIGNERS[request.param](each, authority.certificate, authority.key) for each in (OLD, CONTENT))
    return old, current


def boundary_of(signed: bytes) -> bytes:
    found = re.search(rb'boundary="([^"]+)"', signed)
    assert found
    return b"--" + found[1]


@pytest.mark.parametrize("ends", ["as it is", "LF", "CRLF"])
def test_what_tools_sign_is_read(signed: bytes, authority: certificates.Issuer, ends: str) -> None:
    if ends != "as it is":
        signed = signed.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n" if ends == "CRLF" else b"\n")
    document = smime.read(signed, pem(authority), where=HERE)
    assert document.content == CONTENT
    assert smime.verify(signed, pem(authority)) == smime.signed_content(signed) == CONTENT
    assert smime.is_current(signed, CONTENT, authority.certificate)
    lines = signed.replace(b"\r\n", b"\n").split(b"\n")
    assert lines[document.lines_before] == CONTENT.split(b"\n")[0]


@pytest.mark.parametrize("content", [b"", b"\n", b"x", b"no line end\n\n\nx", b"\n\n\n"], ids=repr)
@pytest.mark.parametrize("signer", ["keymint", "openssl-smime", "sros2"])
def test_contents_at_the_edges(authority: certificates.Issuer, signer: str, content: bytes) -> None:
    signed = SIGNERS[signer](content, authority.certificate, authority.key)
    assert smime.verify(signed, pem(authority), where=HERE) == content


def refused(signed: bytes, authority: certificates.Issuer) -> KeymintError:
    with pytest.raises(KeymintError) as caught:
        smime.read(signed, pem(authority), where=HERE)
    assert not smime.is_current(signed, CONTENT, authority.certificate)
    return caught.value


def spliced(old: bytes, current: bytes, behind: bytes = b"") -> bytes:
    """Put an old document in front of the parts of the current one, between lines that begin like a separator.

    Args:
        old: a signed document.
        current: another one.
        behind: follows the final separator of the old one; empty: it is the first separator of the current one as well.
    """
    separator = boundary_of(current)
    end = b"\r\n" if current.split(b"\n")[0].endswith(b"\r") else b"\n"
    _, text, signature, _ = old.split(boundary_of(old))
    head, rest = current.split(separator, 1)
    again = behind + end + separator if behind else b""
    return b"".join((head, separator, b"x", text, separator, b"x", signature, separator, b"--", again, rest))


@pytest.mark.parametrize("behind", [b"", b"x", b" "])
def test_an_old_document_between_lines_that_begin_like_a_separator(
    openssl, genuine: tuple[bytes, bytes], authority: certificates.Issuer, behind: bytes
) -> None:
    """The attack: no key is needed, openssl and every vendor read the old document."""
    forged = spliced(*genuine, behind)
    openssl.put(ca=pem(authority), forged=forged)
    openssl.accepts("smime", "-verify", "-text", "-in", "forged", "-CAfile", "ca", "-out", "content")
    assert (openssl.folder / "content").read_bytes().replace(b"\r\n", b"\n") == OLD
    error = refused(forged, authority)
    assert str(error).startswith("permissions.p7s:6: ")
    assert error.diagnostics[0].code == "smime-form"


def _insert(before: bytes, text: bytes) -> Change:
    return lambda signed: signed.replace(before, text + before, 1)


HEADER = b"Content-Type: multipart/signed"
CHANGES: dict[str, tuple[Change, str]] = {
    "a blank line in front": (lambda s: b"\n" + s, ":1: "),
    "a header in front": (lambda s: b"Subject: x\n" + s, ":1: "),
    "a byte order mark": (lambda s: b"\xef\xbb\xbf" + s, ":1: "),
    "a header twice": (_insert(HEADER, b"Content-Type: multipart/signed; boundary=x\n"), ":2: "),
    "a folded header": (lambda s: s.replace(b"; micalg", b";\n micalg", 1), ":2: "),
    "another case": (lambda s: s.replace(HEADER, HEADER.lower(), 1), ":2: "),
    "a comment": (lambda s: s.replace(HEADER, HEADER + b" (x)", 1), ":2: "),
    "a boundary of one character": (lambda s: s.replace(boundary_of(s)[2:], b"b"), ":2: "),
    "a second boundary": (lambda s: s.replace(b"; micalg", b'; boundary="x"; micalg', 1), ":2: "),
    "a preamble": (lambda s: s.replace(b"This is", b"x\nThis is", 1), ":4: "),
    "an epilogue": (lambda s: s + b"x\n", ""),
    "a second document": (lambda s: s + s, ""),
    "text behind a separator": (lambda s: s.replace(boundary_of(s), boundary_of(s) + b" ", 1), ":6: "),
    "an inner header": (lambda s: re.sub(rb"Content-Type: text/plain(\r?\n)", rb"X: y\1\g<0>", s, count=1), ":7: "),
    "another inner type": (lambda s: s.replace(b"text/plain", b"text/html", 1), ":7: "),
    "another encoding": (lambda s: s.replace(b"base64", b"8bit", 1), ""),
    "spaces in base64": (lambda s: re.sub(rb"(MII.{20})", rb"\1 ", s, count=1), ""),
    "base64 in longer lines": (lambda s: re.sub(rb"(\n[\w+/]{64})\r?\n", rb"\1", s, count=1), ""),
    "a carriage return": (lambda s: s.replace(b"<topic>", b"<topic>\r", 1), ":11: "),
    "a NUL byte": (lambda s: s.replace(b"<topic>", b"<topic>\0", 1), ":11: "),
    "a separator within a line": (lambda s: s.replace(b"<topic>", b"<topic>" + boundary_of(s), 1), ":11: "),
    "a separator in a piece of a long line": (lambda s: s.replace(b"x" * 1023, b"x" * 1023 + boundary_of(s), 1), ""),
    "no final separator": (lambda s: s[: s.rindex(boundary_of(s))], ""),
    "no second hyphens": (lambda s: s.replace(boundary_of(s) + b"--", boundary_of(s), 1), ""),
    "nothing": (lambda _: b"", ":1: "),
    "a line": (lambda s: s.split(b"\n")[0] + b"\n", ":2: "),
    "no text": (lambda s: re.sub(rb"(?s)(text/plain\r?\n).*(\n--)", rb"\1\2", s, count=1), ""),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_has_not_exactly_one_reading_is_refused(
    genuine: tuple[bytes, bytes], authority: certificates.Issuer, change: str
) -> None:
    current = genuine[1]
    make, place = CHANGES[change]
    changed = make(current)
    assert changed != current
    error = refused(changed, authority)
    assert error.diagnostics[0].code == "smime-form"
    assert f"permissions.p7s{place or ':'}" in str(error), error
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("-md", "sha1"), "sha1, expected sha-256, sha-384 or sha-512"),
        (("-noattr",), "signed attributes"),
        (("-nocerts",), "one certificate"),
        (("-nodetach",), "expected 'Content-Type: multipart/signed"),
        (("-outform", "DER"), "NUL byte"),
        (("-outform", "PEM"), "expected 'MIME-Version: 1.0'"),
    ],
)
def test_other_forms_that_openssl_writes_are_refused(
    authority: certificates.Issuer, options: tuple[str, ...], reason: str
) -> None:
    error = refused(by_openssl(CONTENT, authority.certificate, authority.key, "smime", *options), authority)
    assert reason in str(error)


def test_other_certificates_and_signers_are_refused(
    openssl, authority: certificates.Issuer, other: certificates.Issuer
) -> None:
    openssl.put(other=pem(other), other_key=keys.to_pem(other.key))
    more = [str(openssl.folder / name) for name in ("other", "other_key")]
    given = (CONTENT, authority.certificate, authority.key, "smime")
    error = refused(by_openssl(*given, "-certfile", more[0]), authority)
    assert "expected one certificate in it" in str(error)
    error = refused(by_openssl(*given, "-signer", more[0], "-inkey", more[1]), authority)
    assert "expected one" in str(error)


@pytest.mark.parametrize("kind", [KeySpec("rsa", size=2048), KeySpec("ec", "SECP384R1")], ids=["rsa", "p384"])
def test_authorities_of_other_kinds(spec, kind: KeySpec) -> None:
    key = keys.generate(kind)
    own = certificates.Issuer(
        certificates.issue(spec(key=kind), key.public_key(), key, authority=True).certificate, key
    )
    for name, sign in SIGNERS.items():
        assert smime.verify(sign(CONTENT, own.certificate, own.key), pem(own)) == CONTENT, name


def test_the_digest_of_the_frame_is_that_of_the_signature(authority: certificates.Issuer) -> None:
    signed = by_sros2(CONTENT, authority.certificate, authority.key).replace(b"sha-256", b"sha-512")
    assert "micalg names sha512, the signature has sha256" in str(refused(signed, authority))


def test_the_first_certificate_is_the_one_that_every_reader_takes(
    openssl, authority: certificates.Issuer, other: certificates.Issuer
) -> None:
    """A permissions CA file in which openssl and ``cryptography`` see different certificates first."""
    signed = smime.sign(CONTENT, authority.certificate, authority.key)
    own, foreign = pem(authority), pem(other)
    openssl.put(foreign=foreign)
    openssl.accepts("x509", "-in", "foreign", "-trustout", "-addtrust", "emailProtection", "-out", "trusted")
    trusted = (openssl.folder / "trusted").read_bytes()
    openssl.put(hidden=b"x" + own + foreign, trusted=trusted + own)
    for name, seen in (("hidden", foreign), ("trusted", foreign)):
        assert openssl.run("x509", "-in", name).stdout == seen
        with pytest.raises(KeymintError, match="that other PEM readers may take"):
            smime.verify(signed, (openssl.folder / name).read_bytes())
    for file in (own, own + foreign, b"Subject: CN = x\n\n" + own, own.replace(b"\n", b"\r\n"), own + b"text\n"):
        assert smime.verify(signed, file) == CONTENT
    for file in (foreign + own, foreign):
        with pytest.raises(KeymintError, match="another certificate"):
            smime.verify(signed, file)


def test_a_chain_that_an_identity_signed_is_refused(spec, authority: certificates.Issuer) -> None:
    key = keys.generate(KeySpec("ec", "SECP256R1"))
    identity = certificates.issue(spec("CN=/evil"), key.public_key(), authority, authority=False)
    for sign in SIGNERS.values():
        forged = sign(CONTENT, identity.certificate, key)
        with pytest.raises(KeymintError, match="another certificate"):
            smime.read(forged, pem(authority))
