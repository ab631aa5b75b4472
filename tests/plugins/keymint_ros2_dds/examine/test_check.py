# SPDX-License-Identifier: Apache-2.0
"""Findings on installed enclaves."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds import build_type

from comarmor.errors import Severity
from keymint.api import KeySpec
from keymint.pki import certificates, smime
from tests.effort import tries
from tests.plugins.examined import examined
from tests.plugins.keymint_ros2_dds.builds import CHATTER
from tests.plugins.keymint_ros2_dds.enclaves import NOW, authority, inspection, installed, revoking
from tests.plugins.keymint_ros2_dds.packages import VALIDITY, package, rule

TALKER = package(CHATTER)


@pytest.fixture(scope="module")
def files():
    return installed(TALKER)


def codes(files, loaded=TALKER, **fields):
    return sorted(found.code for found in examined(build_type, inspection(loaded, files, **fields)))


def signed(content: bytes, name: str = "permissions_ca") -> bytes:
    signer = authority(name)
    return smime.sign(content, signer.certificate, signer.key)


def edited(files, old: bytes, new: bytes):
    """Return an enclave whose permissions were edited and signed again."""
    content = files["permissions.xml"].replace(old, new)
    assert content != files["permissions.xml"]
    return {**files, "permissions.xml": content, "permissions.p7s": signed(content)}


def test_what_was_just_installed_is_clean(files):
    assert examined(build_type, inspection(TALKER, files)) == ()
    assert build_type.check_all([inspection(TALKER, files)]) == ()


@pytest.mark.parametrize(
    "name",
    ["identity_ca.cert.pem", "permissions_ca.cert.pem", "cert.pem", "key.pem", "governance.p7s", "permissions.p7s",
     "permissions.xml"],
)  # fmt: skip
def test_any_flipped_bit_is_found(files, name):
    @settings(max_examples=tries(30, 60), deadline=None)
    @given(at=st.integers(0, len(files[name]) - 1), bit=st.integers(0, 7))
    def law(at, bit):
        content = bytearray(files[name])
        content[at] ^= 1 << bit
        found = examined(build_type, inspection(TALKER, {**files, name: bytes(content)}))
        assert any(each.severity is Severity.ERROR and each.where for each in found)
        assert not any(b"PRIVATE" in str(each).encode() for each in found)

    law()


def test_missing_files(files):
    without = {name: content for name, content in files.items() if name != "governance.p7s"}
    assert codes(without) == ["file-missing"]
    assert codes({}).count("file-missing") == 7


def test_a_revocation_list_is_judged(files):
    own = certificates.load(files["cert.pem"]).serial_number
    assert codes({**files, "crl.pem": revoking("identity_ca", 7)}) == []
    for wrong in (b"garbage", revoking("stranger", 7), revoking("identity_ca", own)):
        assert codes({**files, "crl.pem": wrong}) == ["revocation-list"]
    late = inspection(TALKER, {**files, "crl.pem": revoking("identity_ca", 7)}, now=NOW + timedelta(days=61))
    assert "revocation-list-expired" in {each.code for each in build_type.check(late)}


def test_a_key_of_another_certificate(files):
    assert codes({**files, "key.pem": installed(TALKER)["key.pem"]}) == ["key-mismatch"]


def test_an_identity_of_another_authority(files):
    other = installed(TALKER, identity="stranger_ca")
    found = codes(other)
    assert "authority-differs" in found
    assert any(code.startswith("chain-") for code in found)


def test_permissions_signed_by_another_authority(files):
    assert codes({**files, "permissions.p7s": signed(files["permissions.xml"], "stranger_ca")}) == ["smime-signer"]


def test_a_certificate_of_another_subject(files):
    other = installed(package(CHATTER, subject="/other"))
    found = codes({**files, "cert.pem": other["cert.pem"], "key.pem": other["key.pem"]})
    assert found == ["certificate-subject", "grant-subject"]


def test_drift(files):
    assert codes(files, package(CHATTER, rule("ALLOW", "ros_topic", "ros_publish", "/new"))) == ["drift"]


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b"CN=/talker,OU=x1", b"CN=/other,OU=x1", "grant-subject"),
        (b"<default>DENY", b"<default>ALLOW", "grant-default"),
        (b"2027-11-20T00:00:00", b"2026-12-20T00:00:00", "grant-expired"),
        (b"2026-11-20T00:00:00", b"2027-02-20T00:00:00", "grant-not-yet-valid"),
        (b"2027-11-20T00:00:00", b"2027-01-20T00:00:00", "grant-expires"),
        (b"2027-11-20T00:00:00", b"2026-10-20T00:00:00", "grant-never-valid"),
        (b"2026-11-20T00:00:00", b"2026-12-31T12:00:00", "grant-slack"),
        (b"<id>0</id>", b"<id>0</id><id_range><min>4</min><max>5</max></id_range>", "domain-uncovered"),
        (b"<validity>", b"<surprise/><validity>", "schema"),
        (b"<topic>rt/chatter</topic>", b"<topic/>", "schema"),
        (b"<validity>", b"<!-- hand-made --><validity>", "document-hazard"),
        (b"<id>0</id>", b"<id_range><min>0</min></id_range>", "document-hazard"),
        (b"rt/chatter", b" rt/chatter", "document-hazard"),
    ],
)
def test_documents_that_were_edited_and_signed_again(files, old, new, code):
    found = codes(edited(files, old, new))
    assert code in found
    assert ("drift" in found) is not (b"<!--" in new), "what means the same is no drift"


def test_every_grant_is_judged(files):
    grant = files["permissions.xml"].partition(b"<grant ")[2].partition(b"</grant>")[0]
    other = grant.replace(b"CN=/talker,OU=x1", b"CN=/other,OU=x1").replace(b"2027-11-20T", b"2026-12-20T")
    found = codes(edited(files, b"</grant>", b"</grant><grant " + other + b"</grant>"))
    assert {"grant-count", "grant-subject", "grant-expired"} <= set(found)


def test_permissions_xml_that_is_not_what_is_signed(files):
    assert codes({**files, "permissions.xml": files["permissions.xml"] + b"\n"}) == ["document-differs"]


def test_expiry_of_the_certificate(files):
    late = VALIDITY.not_after - timedelta(days=10)
    assert codes(files, now=late) == ["certificate-expires", "grant-expires"]
    assert codes(files, now=late, within_days=5) == []
    over = codes(files, now=VALIDITY.not_after + timedelta(days=1))
    assert over == ["certificate-expired", "grant-expired"]
    early = codes(files, now=VALIDITY.not_before - timedelta(hours=1))
    assert early == ["certificate-not-yet-valid", "grant-not-yet-valid"]
    assert codes(files, now=VALIDITY.not_before + timedelta(hours=1)) == ["grant-slack"]


def test_an_authority_that_is_missing_hides_no_expiry(files):
    chains = {"identity": b"", "permissions": authority("permissions_ca").pem}
    late = VALIDITY.not_after + timedelta(days=1)
    assert {"certificate-expired", "authority-missing"} <= set(codes(files, chains=chains, now=late))
    assert "certificate-expired" not in codes(files, chains=chains)


def test_an_authority_that_expired_hides_nothing_else(files):
    long_after = VALIDITY.not_after + timedelta(days=36_500)
    drifted = package(CHATTER, rule("ALLOW", "ros_topic", "ros_publish", "/new"))
    found = codes(files, drifted, now=long_after)
    assert {"certificate-expired", "grant-expired", "drift"} <= set(found)
    altered = {**files, "permissions.p7s": files["permissions.p7s"].replace(b"rt/chatter", b"rt/chattex", 1)}
    found = codes(altered, now=long_after)
    assert "smime-altered" in found
    assert "grant-expired" not in found


def test_sizes_are_judged_on_the_signed_files():
    many = package(
        rule("ALLOW", "ros_topic", "ros_publish", *(f"/robot/topic_number_{n * n * 7919}" for n in range(1300)))
    )
    assert codes(installed(many), many) == ["size-permissions"]


def test_an_encrypted_key_is_judged_by_its_frame(files):
    locked = replace(TALKER.identity, key=KeySpec("ec", "SECP256R1", password_env="PASSWORD"))
    assert codes(files, replace(TALKER, identity=locked)) == []
