# SPDX-License-Identifier: Apache-2.0
"""URIs of keys in tokens."""

from __future__ import annotations

import pytest

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki.tokens.pkcs11_uri import parse

HERE = Origin("profile/authorities.xml", 9)


def test_what_tools_print_is_read() -> None:
    uri = parse(
        "pkcs11:model=SoftHSM%20v2;manufacturer=SoftHSM%20project;serial=220f8157c504a14b;token=My%20CA;"
        "id=%01%ff;object=identity%2Fca;type=private?module-path=/usr/lib/softhsm/libsofthsm2.so&pin-source=file:/etc/pin"
    )
    assert uri.token == {
        "model": "SoftHSM v2", "manufacturer": "SoftHSM project", "serial": "220f8157c504a14b", "token": "My CA"
    }  # fmt: skip
    assert (uri.label, uri.id) == ("identity/ca", b"\x01\xff")
    assert (uri.module_path, uri.pin_file) == ("/usr/lib/softhsm/libsofthsm2.so", "/etc/pin")
    assert uri.path.endswith(";type=private")


@pytest.mark.parametrize("source", ["file:/run/my%20pin", "file:///run/my%20pin", "/run/my%20pin"])
def test_a_pin_file(source: str) -> None:
    assert parse(f"pkcs11:token=ca;object=ca?pin-source={source}").pin_file == "/run/my pin"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("file:/ca.pem", "is not a PKCS #11 URI"),
        ("pkcs11:object=ca", "does not say which token"),
        ("pkcs11:token=ca", "does not say which key"),
        ("pkcs11:token=ca;object=ca;type=cert", "is of type 'cert'"),
        ("pkcs11:token=ca;token=ca;object=ca", "two attributes 'token'"),
        ("pkcs11:token=ca;objekt=ca", "attribute 'objekt' that is not supported (did you mean 'object'?)"),
        ("pkcs11:token=my ca;object=ca", "expected name=value (write a blank as %20)"),
        ("pkcs11:token=%zz;object=ca", "expected name=value"),
        ("pkcs11:token=%ff;object=ca", "is not UTF-8"),
        ("pkcs11:token=%00;object=ca", "has a NUL"),
        ("pkcs11:token;object=ca", "expected name=value"),
        ("pkcs11:slot-id=x;object=ca", "slot-id=x is not a number"),
        ("pkcs11:token=ca;object=ca?module-path=evil.so", "is not an absolute path"),
        ("pkcs11:token=ca;object=ca?module-name=softhsm2", "attribute 'module-name' that is not supported"),
        ("pkcs11:token=ca;object=ca?pin-source=|cat%20/etc/pin", "is not a file"),
        ("pkcs11:token=ca;object=ca?pin-source=file:pin", "is not a file"),
        ("pkcs11:token=ca;object=ca?pin-source=file://host/pin", "is not a file"),
        ("pkcs11:" + "token=a;" * 600, "is not a PKCS #11 URI"),
    ],
)
def test_other_uris_are_refused(text: str, problem: str) -> None:
    with pytest.raises(KeymintError) as error:
        parse(text, HERE)
    (found,) = error.value.diagnostics
    assert found.code == "pkcs11-uri"
    assert found.where == HERE
    assert problem in f"{found.message} ({found.help})"


@pytest.mark.parametrize(
    "text",
    [
        "pkcs11:token=ca;object=ca?pin-value=12345",
        "pkcs11:token=ca;object=ca;pin-value=12345",
        "pkcs11:token=ca;object=ca?Pin-Value=12345",
        "pkcs11:token=ca;object=ca?pin-value=12 345#",
        "pkcs11:pin-value=12345",
        "pin-value=12345",
    ],
)
def test_a_pin_in_the_uri_is_refused_and_not_shown(text: str) -> None:
    with pytest.raises(KeymintError, match="contains the PIN") as error:
        parse(text, HERE)
    assert "345" not in str(error.value.diagnostics)
