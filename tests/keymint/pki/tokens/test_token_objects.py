# SPDX-License-Identifier: Apache-2.0
"""What tokens answer: public keys in the forms that tokens return them in, and their errors in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives import serialization

from comarmor.errors import Origin
from keymint.api import KeySpec
from keymint.errors import KeymintError
from keymint.pki import certificates, der, keys
from keymint.pki.tokens.token_sessions import Tokens
from tests.keymint.pki.conftest import make_spec
from tests.softhsm import PIN, SoftHsm

pkcs11 = pytest.importorskip("pkcs11", reason="the extra 'pkcs11' is not installed")
from keymint.pki.tokens.token_objects import public_of, token_error  # noqa: E402 - it needs the extra

HERE = Origin("profile/authorities.xml", 9)
SPECS = [KeySpec("ec", "SECP256R1"), KeySpec("ec", "SECP384R1"), KeySpec("ec", "SECP521R1"), KeySpec("rsa", size=2048)]
CURVES = {"secp256r1": "1.2.840.10045.3.1.7", "secp384r1": "1.3.132.0.34", "secp521r1": "1.3.132.0.35"}


@dataclass
class Key:
    """A private key of a token."""

    key_type: Any
    attributes: dict[Any, bytes]
    label: str = "ca"
    id: bytes = b"\1"

    def __getitem__(self, attribute: Any) -> bytes:
        return self.attributes[attribute]


@dataclass
class Session:
    """A session that has some objects beside a private key."""

    objects: list[dict[Any, Any]] = field(default_factory=list)
    asked: list[dict[Any, Any]] = field(default_factory=list)

    def get_objects(self, wanted: dict[Any, Any]) -> list[dict[Any, Any]]:
        self.asked.append(wanted)
        return [each for each in self.objects if each[pkcs11.Attribute.CLASS] == wanted[pkcs11.Attribute.CLASS]]


def point_of(public: Any) -> bytes:
    form = serialization.Encoding.X962, serialization.PublicFormat.UncompressedPoint
    return public.public_bytes(*form)


def in_token(public: Any, *, wrapped: bool = True) -> tuple[Key, Session]:
    """Return a private key of a token and its session, which has the public key beside it."""
    attribute = pkcs11.Attribute
    if hasattr(public, "curve"):
        parameters = der.oid(CURVES[public.curve.name])
        point = der.tlv(der.OCTET_STRING, point_of(public)) if wrapped else point_of(public)
        beside = {attribute.CLASS: pkcs11.ObjectClass.PUBLIC_KEY, attribute.EC_POINT: point}
        return Key(pkcs11.KeyType.EC, {attribute.EC_PARAMS: parameters}), Session([beside])
    numbers = public.public_numbers()
    values = {attribute.MODULUS: numbers.n.to_bytes(256), attribute.PUBLIC_EXPONENT: numbers.e.to_bytes(3)}
    return Key(pkcs11.KeyType.RSA, values), Session()


@pytest.mark.parametrize("spec", SPECS, ids=str)
@pytest.mark.parametrize("wrapped", [True, False])
def test_public_keys(spec: KeySpec, wrapped: bool) -> None:
    public = keys.generate(spec).public_key()
    key, session = in_token(public, wrapped=wrapped)
    assert public_of(session, key, HERE) == public


def test_a_point_whose_first_octets_look_like_an_octet_string() -> None:
    """Both begin with 4; here the second octet is the length of the rest as well."""
    while True:
        public = keys.generate(SPECS[0]).public_key()
        if point_of(public)[1] == len(point_of(public)) - 2:
            break
    key, session = in_token(public, wrapped=False)
    assert public_of(session, key, HERE) == public


def test_the_public_key_has_the_identifier_of_the_private_one_or_else_its_label() -> None:
    public = keys.generate(SPECS[0]).public_key()
    key, session = in_token(public)
    public_of(session, key, HERE)
    assert session.asked[0][pkcs11.Attribute.ID] == b"\1"
    key.id = b""
    public_of(session, key, HERE)
    assert session.asked[-1][pkcs11.Attribute.LABEL] == "ca"


def test_a_key_of_another_kind() -> None:
    for key in (Key(pkcs11.KeyType.DSA, {}), Key(pkcs11.KeyType.EC, {pkcs11.Attribute.EC_PARAMS: b"\x06\x01\x00"})):
        with pytest.raises(KeymintError, match="neither RSA nor EC on a known curve") as error:
            public_of(Session(), key, HERE)
        assert error.value.diagnostics[0].code == "token-key-kind"


@pytest.mark.softhsm
def test_the_certificate_in_the_token_is_enough(softhsm: SoftHsm, tmp_path: Path) -> None:
    tokens = Tokens({}, lambda *_: PIN)
    spec = KeySpec("ec", "SECP256R1", uri=softhsm.make_key("ca"))
    public = tokens.public_key(spec)
    issued = certificates.issue(make_spec(), public, tokens.private_key(spec, public), authority=True).certificate
    tokens.close()
    file = tmp_path / "ca.der"
    file.write_bytes(issued.public_bytes(serialization.Encoding.DER))
    softhsm.delete("ca", "pubkey")
    softhsm.tool("--write-object", file, "--type", "cert", "--label", "ca", "--id", "01")
    assert tokens.public_key(spec) == public
    tokens.close()


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        ("PinIncorrect", "token-pin", "is wrong"),
        ("PinLenRange", "token-pin", "is wrong"),
        ("PinLocked", "token-pin", "is locked"),
        ("PinExpired", "token-pin", "is expired"),
        ("UserPinNotInitialized", "token-pin", "is not set"),
        ("DeviceRemoved", "token-failed", "was removed, or ended the session"),
        ("SessionHandleInvalid", "token-failed", "was removed, or ended the session"),
        ("MechanismInvalid", "token-key-kind", "cannot sign with this key"),
        ("HostMemory", "token-failed", "failed: HostMemory"),
    ],
)
def test_errors_in_words(error: str, code: str, said: str) -> None:
    (found,) = token_error(getattr(pkcs11, error)(), "ca", HERE).diagnostics
    assert (found.code, found.where) == (code, HERE)
    assert said in found.message
    assert found.help
    assert "\n" not in found.message + found.help
