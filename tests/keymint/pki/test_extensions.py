# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import pytest

from comarmor.errors import Origin
from keymint.api import Extension
from keymint.errors import KeymintError
from keymint.pki import certificates, extensions, keys

HERE = Origin("authorities.xml", 12)


@pytest.mark.parametrize(
    ("name", "value", "printed"),
    [
        ("basicConstraints", "critical, CA:TRUE, pathlen:3", "CA:TRUE, pathlen:3"),
        ("keyUsage", "critical,digitalSignature,keyCertSign", "Digital Signature, Certificate Sign"),
        ("extendedKeyUsage", "clientAuth, 1.2.3.4", "TLS Web Client Authentication, 1.2.3.4"),
        ("subjectAltName", "DNS:a.b, IP:10.0.0.1, IP:::1, email:a@b.c", "DNS:a.b, IP Address:10.0.0.1"),
        ("issuerAltName", "URI:https://a.b/c", "URI:https://a.b/c"),
        ("certificatePolicies", "1.2.3.4, anyPolicy", "Policy: 1.2.3.4"),
        ("crlDistributionPoints", "URI:http://a.b/c.crl", "URI:http://a.b/c.crl"),
        ("authorityInfoAccess", "OCSP;URI:http://a.b, caIssuers;URI:http://a.b/c", "OCSP - URI:http://a.b"),
        ("subjectKeyIdentifier", "00:01:02:ff", "00:01:02:FF"),
        ("authorityKeyIdentifier", "keyid:always", "X509v3 Authority Key Identifier"),
        ("nsComment", "made by hand", "made by hand"),
        ("1.2.3.4.5", "ASN1:UTF8String:text: more", "1.2.3.4.5"),
        ("1.2.3.4.5", "DER:0c:02:68:69", "..hi"),
    ],
)
def test_openssl_prints_what_was_asked_for(openssl, spec, name: str, value: str, printed: str) -> None:
    key = keys.generate(spec().key)
    issued = certificates.issue(
        replace(spec(), extensions=(Extension(name, value, False, HERE),)), key.public_key(), key, authority=True
    )
    openssl.put(ca=issued.pem)
    shown = openssl.run("x509", "-in", "ca", "-noout", "-text").stdout.decode()
    assert printed in shown
    openssl.accepts("verify", "-CAfile", "ca", "ca")


@pytest.mark.parametrize(
    ("name", "title"), [("subjectKeyIdentifier", "Subject Key"), ("authorityKeyIdentifier", "Authority Key")]
)
def test_key_identifiers_can_be_left_out(openssl, spec, authority, name: str, title: str) -> None:
    public = keys.generate(spec().key).public_key()
    without = certificates.issue(spec("CN=/a", **{name: "none"}), public, authority, authority=False)
    openssl.put(a=without.pem, b=certificates.issue(spec("CN=/a"), public, authority, authority=False).pem)
    assert title not in openssl.run("x509", "-in", "a", "-noout", "-text").stdout.decode()
    assert title in openssl.run("x509", "-in", "b", "-noout", "-text").stdout.decode()


def test_the_issuer_can_be_named_by_serial_number(openssl, spec, authority) -> None:
    issued = certificates.issue(
        spec("CN=/a", authorityKeyIdentifier="keyid, issuer:always"),
        keys.generate(spec().key).public_key(),
        authority,
        authority=False,
    )
    openssl.put(ca=certificates.to_pem(authority.certificate), a=issued.pem)
    assert "DirName:" in openssl.run("x509", "-in", "a", "-noout", "-text").stdout.decode()
    openssl.accepts("verify", "-x509_strict", "-CAfile", "ca", "a")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("keyusage", "digitalSignature", "did you mean 'keyUsage'?"),
        ("frobnicate", "x", "known are basicConstraints"),
        ("keyUsage", "", "an entry is empty"),
        ("keyUsage", "cRLSign, cRLSign", "occurs twice"),
        ("keyUsage", "crlSign", "did you mean 'cRLSign'?"),
        ("extendedKeyUsage", "serverauth", "did you mean 'serverAuth'?"),
        ("extendedKeyUsage", "1..2", "neither a known name nor a dotted OID"),
        ("basicConstraints", "pathlen:1", "is missing"),
        ("basicConstraints", "CA:yes", "neither CA:TRUE"),
        ("basicConstraints", "CA:FALSE, pathlen:1", "path_length must be None"),
        ("subjectAltName", "dns:a", "did you mean 'DNS'?"),
        ("subjectAltName", "IP:1.2.3", "does not appear to be"),
        ("subjectAltName", "DNS:", "nothing follows"),
        ("subjectAltName", "DNS:é", "not ASCII"),
        ("authorityInfoAccess", "ocsp;URI:http://a", "did you mean 'OCSP'?"),
        ("authorityKeyIdentifier", "hash", "expected keyid"),
        ("subjectKeyIdentifier", "xyz", "not hexadecimal"),
        ("nsComment", "é", "ordinal not in range"),
        ("1.2.3.4", "text", "expected DER:"),
        ("1.2.3.4", "DER:", "no hexadecimal digits"),
        ("1.2.3.4", "DER:0c05", "truncated"),
        ("1.2.3.4", "DER:05000500", "not one DER element"),
        ("1.2.3.4", "ASN1:UTF9:x", "did you mean 'UTF8'?"),
        ("2.5.29.15", "DER:03020106", "write keyUsage"),
        ("1.2", "DER:0500", "OID"),
    ],
)
def test_what_is_not_in_the_notation_is_an_error_with_its_place(spec, name: str, value: str, message: str) -> None:
    context = extensions.Context(keys.generate(spec().key).public_key(), None)
    if name == "1.2":  # legal as an OID; nothing else is to be said of it
        assert extensions.parse(Extension(name, value, True, HERE), context)[1]
        return
    with pytest.raises(KeymintError) as caught:
        extensions.parse(Extension(name, value, False, HERE), context)
    assert message in str(caught.value)
    assert str(caught.value).startswith("authorities.xml:12: ")


def test_bytes_that_are_not_an_extensions_syntax_are_refused(spec) -> None:
    raw = Extension("2.5.29.30", "DER:0500", False, HERE)  # nameConstraints that are NULL
    key = keys.generate(spec().key)
    with pytest.raises(KeymintError, match="syntax of its OID"):
        certificates.issue(replace(spec(), extensions=(raw,)), key.public_key(), key, authority=True)


def test_an_extension_stands_once(spec) -> None:
    twice = (Extension("nsComment", "a", False, HERE), Extension("nsComment", "b", False, replace(HERE, line=13)))
    key = keys.generate(spec().key)
    with pytest.raises(KeymintError, match=r"authorities\.xml:13: .*occurs twice"):
        certificates.issue(replace(spec(), extensions=twice), key.public_key(), key, authority=True)
