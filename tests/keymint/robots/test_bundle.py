# SPDX-License-Identifier: Apache-2.0
"""A bundle is whole, and signed by the issuer of its certificate; openssl verifies the signature."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from keymint.api import Extension
from keymint.errors import KeymintError
from keymint.pki import certificates, cms, keys
from keymint.robots import bundle
from keymint.robots.bundle import dump
from tests.effort import FULL

from .conftest import FILE, Made, authority, revocations, robot_key, spec


def members(made: Made | None = None) -> dict[str, bytes]:
    return dict(bundle.unpack((made or Made()).packed, FILE))


def code(changed: Mapping[str, bytes]) -> str:
    with pytest.raises(KeymintError) as refused:
        bundle.read(bundle.pack(changed), FILE)
    [diagnostic] = refused.value.diagnostics
    assert diagnostic.where == FILE
    assert diagnostic.help
    return diagnostic.code


def test_what_is_written_is_read() -> None:
    made = Made()
    read = made.bundle
    assert read.files == made.files
    assert read.signer == made.identity.certificate
    assert replace(read.manifest, files={}) == made.manifest
    assert set(read.authorities) == {"identity_ca.cert.pem", "permissions_ca.cert.pem"}
    assert bundle.number_of(read.lists, read.signer) == 3


@pytest.mark.parametrize("name", sorted(Made(with_key=True).files))
def test_an_altered_file_is_refused(name: str) -> None:
    content = members(Made(with_key=True))
    assert code({**content, name: content[name] + b"\n"}) == "bundle-altered"


def test_files_are_neither_added_nor_left_out() -> None:
    content = members()
    assert code({**content, "key.p11": b"pkcs11:"}) == "bundle-altered"
    for name in set(content) - {"manifest.json"}:
        assert code({each: data for each, data in content.items() if each != name}) == "bundle-altered"
    assert code({"cert.pem": content["cert.pem"]}) == "bundle-manifest"


def test_files_are_not_exchanged() -> None:
    content = members()
    names = "identity_ca.cert.pem", "permissions_ca.cert.pem"
    swapped = {names[0]: content[names[1]], names[1]: content[names[0]]}
    assert code({**content, **swapped}) == "bundle-altered"


def test_an_altered_manifest_is_refused() -> None:
    made, content = Made(), members()
    for changed in (made.but(issue=9), made.but(nonce="ab" * 16), made.but(generation=1), made.but(name="robot/other")):
        manifest = dump(replace(changed.manifest, files=made.bundle.manifest.files))
        assert code({**content, "manifest.json": manifest}) == "bundle-altered"


def test_a_signature_by_somebody_else_is_refused() -> None:
    made, content = Made(), members()
    for other in (authority("rights"), authority("ca2"), identity()):
        signature = cms.sign(content["manifest.json"], other.certificate, other.key)
        assert code({**content, "manifest.cms": signature}) == "bundle-altered"
    claimed = replace(made.bundle.manifest, authority=keys.fingerprint(authority("rights").key))
    encoded = dump(claimed)
    other = authority("rights")
    signature = cms.sign(encoded, other.certificate, other.key)
    assert code({**content, "manifest.json": encoded, "manifest.cms": signature}) == "bundle-altered"


def identity() -> certificates.Issuer:
    """Return an enclave that tries to act as its authority."""
    made = Made()
    return certificates.Issuer(certificates.load(made.certificate), made.key)


def test_another_authority_of_the_same_name_is_another_authority() -> None:
    impostor_key = robot_key("impostor")
    impostor = certificates.Issuer(
        certificates.issue(spec("CN=ca"), impostor_key.public_key(), impostor_key, authority=True).certificate,
        impostor_key,
    )
    content = members()
    signature = cms.sign(content["manifest.json"], impostor.certificate, impostor.key)
    assert code({**content, "manifest.cms": signature}) == "bundle-altered"


def test_the_key_of_the_certificate_is_that_of_the_manifest() -> None:
    made = Made()
    manifest = replace(made.manifest, key="0" * 64)
    with pytest.raises(KeymintError) as refused:
        bundle.read(bundle.write(manifest, made.files, made.identity), FILE)
    assert refused.value.diagnostics[0].code == "bundle-altered"


def test_a_damaged_revocation_list_is_refused() -> None:
    assert code(members(Made(number=0, more={"crl.pem": b"-----BEGIN X509 CRL-----\nAAAA\n"}))) == "bundle-altered"


def test_every_altered_byte_is_noticed() -> None:
    packed = Made().packed
    for at in range(0, len(packed), 1 if FULL else 97):
        altered = bytearray(packed)
        altered[at] ^= 1 << at % 8
        with pytest.raises(KeymintError) as refused:
            bundle.read(bytes(altered), FILE)
        assert refused.value.diagnostics[0].code.startswith("bundle-"), at


@pytest.mark.parametrize("part", range(1, 20))
def test_a_truncated_bundle_is_refused(part: int) -> None:
    packed = Made().packed
    with pytest.raises(KeymintError):
        bundle.read(packed[: len(packed) * part // 20], FILE)


def test_lists_may_be_in_the_file_of_authorities() -> None:
    """Fast DDS reads the lists of two authorities from their file."""
    made = Made(number=0)
    file = certificates.to_pem(made.identity.certificate) + revocations(made.identity, 4) + revocations(made.rights, 7)
    read = Made(number=4, more={"identity_ca.cert.pem": file, "crl.pem": b""}).bundle
    assert bundle.number_of(read.lists, read.signer) == 4
    assert bundle.number_of(read.lists, made.rights.certificate) == 7


def test_an_authority_that_may_not_sign_documents_writes_none() -> None:
    key = robot_key("adopted")
    usage = Extension("keyUsage", "keyCertSign, cRLSign", True, FILE)
    adopted = certificates.issue(
        replace(spec("CN=adopted"), extensions=(usage,)), key.public_key(), key, authority=True
    ).certificate
    made = Made(identity=certificates.Issuer(adopted, key))
    with pytest.raises(KeymintError) as refused:
        made.packed  # noqa: B018 - made by the first use
    assert refused.value.diagnostics[0].code == "authority-cannot-sign"


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(KeymintError) as refused:
        Made(more={"big.xml": b"x" * bundle.MAX_BYTES}).packed  # noqa: B018
    assert refused.value.diagnostics[0].code == "bundle-size"


@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
def test_openssl_verifies_the_signature(tmp_path: Path) -> None:
    made = Made()
    (tmp_path / "talker.bundle").write_bytes(made.packed)
    subprocess.run(["tar", "-xf", "talker.bundle"], cwd=tmp_path, check=True)
    asked = ["openssl", "cms", "-verify", "-binary", "-inform", "DER", "-in", "manifest.cms"]
    asked += ["-content", "manifest.json", "-CAfile", "identity_ca.cert.pem", "-no_check_time"]
    assert subprocess.run(asked, cwd=tmp_path, check=True, capture_output=True).stdout == made.bundle.encoded
    (tmp_path / "manifest.json").write_bytes(made.bundle.encoded.replace(b'"issue":5', b'"issue":6'))
    assert subprocess.run(asked, cwd=tmp_path, check=False, capture_output=True).returncode != 0
