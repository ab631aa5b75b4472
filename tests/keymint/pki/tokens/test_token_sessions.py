# SPDX-License-Identifier: Apache-2.0
"""Sessions with tokens: one for each, opened when it is needed, and what goes wrong with them."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, padding

from comarmor.errors import Diagnostic, Origin
from keymint.api import KeySpec
from keymint.api.plugin_loader import how_to_add
from keymint.errors import KeymintError
from keymint.pki import keys
from keymint.pki.tokens.token_sessions import MODULE_VARIABLE, Tokens
from tests.softhsm import MODULE, PIN, SoftHsm

pytestmark = pytest.mark.softhsm
HERE = Origin("profile/authorities.xml", 9)
ECDSA = ec.ECDSA(hashes.SHA256())


@dataclass
class Asked:
    """Gives PINs, and records for which tokens."""

    pin: str = PIN
    for_tokens: list[str] = field(default_factory=list)

    def __call__(self, text: str) -> str:
        self.for_tokens.append(text.removeprefix("PIN of the token ").removesuffix(": "))
        return self.pin


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def tokens(asked: Asked) -> Iterator[Tokens]:
    opened = Tokens({}, asked)
    yield opened
    opened.close()


def spec(uri: str) -> KeySpec:
    return KeySpec("ec", "SECP256R1", uri=uri)


def error_of(work: Callable[[], object]) -> Diagnostic:
    with pytest.raises(KeymintError) as error:
        work()
    (found,) = error.value.diagnostics
    assert "\n" not in found.message + found.help
    assert found.where == HERE
    return found


def test_a_token_is_opened_once_and_only_to_sign(softhsm: SoftHsm, tokens: Tokens, asked: Asked) -> None:
    one, two = (spec(softhsm.make_key(name, number)) for name, number in (("one", "01"), ("two", "02")))
    public = tokens.public_key(one, HERE)
    tokens.close()
    asked.for_tokens.clear()
    key = tokens.private_key(one, public, HERE)
    assert key.public_key() == public
    assert asked.for_tokens == []
    for _ in range(3):
        public.verify(key.sign(b"data", ECDSA), b"data", ECDSA)
    tokens.private_key(two, tokens.public_key(two, HERE), HERE).sign(b"data", ECDSA)
    assert asked.for_tokens == ["ca"]


def test_two_tokens_have_a_session_each(softhsm: SoftHsm, tokens: Tokens, asked: Asked) -> None:
    other = softhsm.another("other")
    for uri in (softhsm.make_key("ca"), other.make_key("ca")):
        tokens.private_key(spec(uri), tokens.public_key(spec(uri), HERE), HERE).sign(b"data", ECDSA)
    assert asked.for_tokens == ["ca", "other"]


def test_a_wrong_pin_is_tried_once(softhsm: SoftHsm, tokens: Tokens, asked: Asked) -> None:
    one, two = softhsm.make_key("one", "01"), softhsm.make_key("two", "02")
    asked.pin = "wrong-secret"
    for uri in (one, one, two):
        found = error_of(lambda uri=uri: tokens.public_key(spec(uri), HERE))
        assert (found.code, found.message) == ("token-pin", "the PIN of the token ca is wrong")
        assert "wrong-secret" not in str(found)
    assert asked.for_tokens == ["ca"]


def test_a_pin_that_is_no_text(softhsm: SoftHsm, tokens: Tokens, asked: Asked) -> None:
    asked.pin = os.fsdecode(b"12\xff34")
    assert error_of(lambda: tokens.public_key(spec(softhsm.make_key("ca")), HERE)).message == "the PIN is not UTF-8"


@pytest.mark.parametrize(
    ("uri", "code", "problem"),
    [
        (
            "pkcs11:token=cb;object=ca",
            "token-missing",
            "there is no token pkcs11:token=cb;object=ca (p11-kit-proxy.so has ca, more)",
        ),
        ("pkcs11:token=ca;serial=0;object=ca", "token-missing", "there is no token"),
        ("pkcs11:manufacturer=SoftHSM%20project;object=ca", "token-ambiguous", "tokens are pkcs11:manufacturer"),
        ("pkcs11:token=ca;object=cc", "token-key-missing", "has no private key pkcs11:token=ca;object=cc"),
        ("pkcs11:token=ca;object=ca;id=%02", "token-key-missing", "it has ca, twice"),
        ("pkcs11:token=ca;object=twice", "token-key-ambiguous", "say which: id=%03, id=%04"),
    ],
)
def test_what_is_not_there_or_not_one(softhsm: SoftHsm, tokens: Tokens, uri: str, code: str, problem: str) -> None:
    softhsm.another("more")
    for label, number in (("ca", "01"), ("twice", "03"), ("twice", "04")):
        softhsm.make_key(label, number)
    found = error_of(lambda: tokens.public_key(spec(uri), HERE))
    assert found.code == code
    assert problem in f"{found.message} ({found.help})"


def test_a_token_by_its_serial_number(softhsm: SoftHsm, tokens: Tokens) -> None:
    softhsm.make_key("ca")
    serial = (
        softhsm.run("pkcs11-tool", "--module", MODULE, "--list-slots").split("serial num")[1].split(":")[1].split()[0]
    )
    assert tokens.public_key(spec(f"pkcs11:serial={serial};id=%01;type=private"), HERE).key_size == 256


def test_a_key_that_was_removed_meanwhile(softhsm: SoftHsm, tokens: Tokens) -> None:
    uri = softhsm.make_key("ca")
    key = tokens.private_key(spec(uri), tokens.public_key(spec(uri), HERE), HERE)
    key.sign(b"data", ECDSA)
    softhsm.delete("ca")
    for _ in range(2):
        found = error_of(lambda: key.sign(b"data", ECDSA))
        assert found.code == "token-failed"
        assert found.message.startswith("the token pkcs11:token=ca;object=ca was removed, or ended the session")
        assert "nothing was written" in found.help


def test_a_token_that_was_removed_meanwhile(softhsm: SoftHsm, tokens: Tokens) -> None:
    uri = softhsm.make_key("ca")
    key = tokens.private_key(spec(uri), tokens.public_key(spec(uri), HERE), HERE)
    shutil.rmtree(softhsm.folder / "tokens")
    assert error_of(lambda: key.sign(b"data", ECDSA)).code == "token-failed"


def test_a_key_without_its_public_key(softhsm: SoftHsm, tokens: Tokens) -> None:
    uri = softhsm.make_key("ca")
    public = tokens.public_key(spec(uri), HERE)
    tokens.close()
    softhsm.delete("ca", "pubkey")
    assert "no public key beside the private key 'ca'" in error_of(lambda: tokens.public_key(spec(uri), HERE)).message
    tokens.close()
    # Where the certificate is known, the private key is enough.
    public.verify(tokens.private_key(spec(uri), public, HERE).sign(b"data", ECDSA), b"data", ECDSA)


def test_an_imported_key_is_the_same_key(softhsm: SoftHsm, tokens: Tokens, tmp_path: Path) -> None:
    key = keys.generate(KeySpec("ec", "SECP256R1"))
    (tmp_path / "ca.key.pem").write_bytes(keys.to_pem(key))
    uri = softhsm.import_key(tmp_path / "ca.key.pem", "ca")
    assert tokens.public_key(spec(uri), HERE) == key.public_key()


def test_a_curve_that_no_vendor_takes(softhsm: SoftHsm, tokens: Tokens) -> None:
    softhsm.tool("--keypairgen", "--key-type", "EC:secp256k1", "--label", "ca", "--id", "01")
    found = error_of(lambda: tokens.public_key(spec("pkcs11:token=ca;object=ca"), HERE))
    assert (found.code, found.message) == (
        "token-key-kind",
        "the token's key 'ca' is neither RSA nor EC on a known curve",
    )


def test_a_module_that_is_missing(softhsm: SoftHsm, asked: Asked) -> None:
    uri = softhsm.make_key("ca")
    opened = Tokens({MODULE_VARIABLE: "/nowhere/module.so"}, asked)
    found = error_of(lambda: opened.public_key(spec(uri), HERE))
    assert found.code == "pkcs11-module"
    assert "/nowhere/module.so" in found.message


def test_the_module_of_a_uri(softhsm: SoftHsm, tokens: Tokens, tmp_path: Path) -> None:
    uri = softhsm.make_key("ca")
    if Path(MODULE).stat().st_uid == 0:
        assert tokens.public_key(spec(f"{uri}?module-path={MODULE}"), HERE).key_size == 256
    other = tmp_path / "evil.so"
    shutil.copy(MODULE, other)
    other.chmod(0o775)
    found = error_of(lambda: tokens.public_key(spec(f"{uri}?module-path={other}"), HERE))
    assert "may have been written by others" in found.message
    assert f"{MODULE_VARIABLE}={other}" in found.help
    found = error_of(lambda: tokens.public_key(spec(f"{uri}?module-path={other}2"), HERE))
    assert "cannot be read" in found.message


def test_a_module_that_the_user_confirms(softhsm: SoftHsm, asked: Asked, tmp_path: Path) -> None:
    own = tmp_path / "own.so"
    shutil.copy(MODULE, own)
    own.chmod(0o775)
    opened = Tokens({MODULE_VARIABLE: str(own)}, asked)
    assert opened.public_key(spec(f"{softhsm.make_key('ca')}?module-path={own}"), HERE).key_size == 256
    opened.close()


def test_a_key_that_asks_for_the_pin_at_each_signature(softhsm: SoftHsm, tokens: Tokens, asked: Asked) -> None:
    softhsm.tool("--keypairgen", "--key-type", "EC:prime256v1", "--label", "ca", "--id", "01", "--always-auth")
    uri = "pkcs11:token=ca;object=ca"
    public = tokens.public_key(spec(uri), HERE)
    key = tokens.private_key(spec(uri), public, HERE)
    for _ in range(2):
        public.verify(key.sign(b"data", ECDSA), b"data", ECDSA)
    assert asked.for_tokens == ["ca"]


def test_a_key_that_may_not_sign(softhsm: SoftHsm, tokens: Tokens) -> None:
    make = (
        "import pkcs11, sys\n"
        "with pkcs11.lib(sys.argv[1]).get_token(token_label='ca').open(rw=True, user_pin=sys.argv[2]) as session:\n"
        "    session.generate_keypair(pkcs11.KeyType.RSA, 2048, label='ca', store=True, id=b'1',\n"
        "        capabilities=pkcs11.MechanismFlag.DECRYPT | pkcs11.MechanismFlag.ENCRYPT)\n"
    )
    softhsm.run(sys.executable, "-c", make, MODULE, PIN)
    uri = "pkcs11:token=ca;object=ca"
    key = tokens.private_key(spec(uri), tokens.public_key(spec(uri), HERE), HERE)
    assert "may not sign" in error_of(lambda: key.sign(b"data", padding.PKCS1v15(), hashes.SHA256())).message


def test_without_the_extra_it_says_what_to_install(
    softhsm: SoftHsm, tokens: Tokens, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pkcs11", None)
    found = error_of(lambda: tokens.public_key(spec("pkcs11:token=ca;object=ca"), HERE))
    assert (found.code, found.help) == ("pkcs11-module", how_to_add("python-pkcs11"))


def test_what_is_released_can_be_opened_again(softhsm: SoftHsm, tokens: Tokens) -> None:
    uri = softhsm.make_key("ca")
    first = tokens.public_key(spec(uri), HERE)
    tokens.close()
    form = serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    assert tokens.public_key(spec(uri), HERE).public_bytes(*form) == first.public_bytes(*form)
