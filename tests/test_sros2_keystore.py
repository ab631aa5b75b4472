# SPDX-License-Identifier: Apache-2.0
"""The keystores of :mod:`tests.sros2_keystore` have the form of SROS2: its documents, openssl, links and modes."""

from __future__ import annotations

import stat
import subprocess
from pathlib import Path

import pytest
from cryptography import x509
from lxml import etree

from comarmor.errors import Origin
from keymint.pki import smime

from . import sros2_keystore
from .sros2_keystore import Form

POLICY = """<policy version="0.2.0"><enclaves>
  <enclave path="/robot/talker"><profiles><profile ns="/robot" node="talker">
    <topics publish="ALLOW" subscribe="DENY"><topic>chatter</topic><topic>~/p</topic></topics>
    <actions call="ALLOW"><action>/dock</action></actions>
  </profile></profiles></enclave>
  <enclave path="/listener"><profiles><profile ns="/" node="listener">
    <topics subscribe="ALLOW"><topic>/robot/chatter</topic></topics>
    <services reply="ALLOW"><service>add</service></services>
  </profile></profiles></enclave>
</enclaves></policy>"""


@pytest.mark.parametrize("name", ["add_two_ints", "talker_listener"])
def test_documents_are_those_of_sros2_to_the_byte(reference: Path, name: str) -> None:
    folder = reference / "sros2"
    tree = etree.parse(folder / f"{name}.policy.xml")
    for _ in range(3):
        tree.xinclude()
    enclaves = sros2_keystore.enclaves_of(etree.tostring(tree).decode())
    made = sros2_keystore.permissions(enclaves, ("2020-05-01T00:00:00", "2030-05-01T00:00:00"), graph=False)
    assert made == (folder / f"expected/{name}.permissions.xml").read_bytes()


def test_the_layout_of_foxy_and_later(tmp_path: Path) -> None:
    root = tmp_path / "keystore"
    assert sros2_keystore.make(root, POLICY, Form(domain=5, governance_domain=3)) == ("/robot/talker", "/listener")
    talker = root / "enclaves/robot/talker"
    links = {path.relative_to(root).as_posix(): str(path.readlink()) for path in root.rglob("*") if path.is_symlink()}
    assert links == {
        "public/identity_ca.cert.pem": "ca.cert.pem",
        "public/permissions_ca.cert.pem": "ca.cert.pem",
        "private/identity_ca.key.pem": "ca.key.pem",
        "private/permissions_ca.key.pem": "ca.key.pem",
        "enclaves/robot/talker/identity_ca.cert.pem": "../../../public/identity_ca.cert.pem",
        "enclaves/robot/talker/permissions_ca.cert.pem": "../../../public/permissions_ca.cert.pem",
        "enclaves/robot/talker/governance.p7s": "../../governance.p7s",
        "enclaves/listener/identity_ca.cert.pem": "../../public/identity_ca.cert.pem",
        "enclaves/listener/permissions_ca.cert.pem": "../../public/permissions_ca.cert.pem",
        "enclaves/listener/governance.p7s": "../governance.p7s",
    }
    modes = {stat.S_IMODE(path.stat().st_mode) for path in root.rglob("*") if path.is_file()}
    assert modes == {0o644}
    assert {stat.S_IMODE(path.stat().st_mode) for path in root.rglob("*") if path.is_dir()} == {0o755}
    assert (talker / "permissions.xml").read_text().count("<id>5</id>") == 3
    assert "<id>3</id>" in (root / "enclaves/governance.xml").read_text()


def test_certificates_have_what_those_of_sros2_have(tmp_path: Path) -> None:
    root = tmp_path / "keystore"
    sros2_keystore.make(root, POLICY, Form(common_names={"/listener": f"/{'x' * 70}"}))
    authority = x509.load_pem_x509_certificate((root / "public/ca.cert.pem").read_bytes())
    assert authority.subject.rfc4514_string() == "CN=sros2CA"
    assert [type(each.value) for each in authority.extensions] == [x509.BasicConstraints]
    own = x509.load_pem_x509_certificate((root / "enclaves/robot/talker/cert.pem").read_bytes())
    assert (own.not_valid_after_utc - own.not_valid_before_utc).days == 3650
    assert own.subject.rfc4514_string() == "CN=/robot/talker"
    long = x509.load_pem_x509_certificate((root / "enclaves/listener/cert.pem").read_bytes())
    with pytest.warns(UserWarning, match="it was 71"):
        assert len(long.subject.rfc4514_string()) == 3 + 71


FORMS = {"one": Form(), "two": Form(two=True), "flat": Form(layout="flat"), "rti": Form(layout="rti")}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_openssl_and_keymint_verify_every_signature(tmp_path: Path, form: Form) -> None:
    root = tmp_path / "keystore"
    sros2_keystore.make(root, POLICY, form)
    places = {"sros2": "public/permissions_ca.cert.pem", "flat": "ca.cert.pem", "rti": "cert/permissions_ca.pem"}
    anchor = root / places[form.layout]
    signed = [path for path in root.rglob("*.p7s") if not path.is_symlink()]
    assert len(signed) == (5 if form.layout == "flat" else 3)
    for path in signed:
        # openssl accepts a certificate without keyUsage, like the vendors, as one that may sign.
        found = subprocess.run(
            ["openssl", "smime", "-verify", "-text", "-in", path, "-CAfile", anchor],
            capture_output=True,
            check=True,
        )
        content = smime.read(path.read_bytes(), anchor.read_bytes(), where=Origin(path.name)).content
        assert found.stdout.replace(b"\r\n", b"\n") == content
        beside = path.with_suffix(".xml")
        if beside.exists():
            assert beside.read_bytes() == content


def test_the_layout_before_foxy(tmp_path: Path) -> None:
    root = tmp_path / "keystore"
    policy = (
        '<policy version="0.1.0"><profiles><profile ns="/robot" node="talker"><topics publish="ALLOW">'
        "<topic>chatter</topic></topics></profile></profiles></policy>"
    )
    assert sros2_keystore.make(root, policy, Form(layout="flat")) == ("/robot/talker",)
    place = root / "robot/talker"
    assert {path.name for path in place.iterdir() if path.is_symlink()} == {
        "identity_ca.cert.pem",
        "permissions_ca.cert.pem",
    }
    assert (place / "governance.p7s").read_bytes() == (root / "governance.p7s").read_bytes()
    document = (place / "permissions.xml").read_text()
    assert "<not_after>2023-10-26T22:45:30</not_after>" in document
    assert "ros_discovery_info" not in document
