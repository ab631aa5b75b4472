# SPDX-License-Identifier: Apache-2.0
"""The install stage: layouts, signatures that are kept while they hold, and what is refused."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from keymint_ros2_dds import build_type

from keymint.api import Artifact, BuildOptions
from keymint.errors import KeymintError
from keymint.pki import smime

from .enclaves import authority, credentials, installed
from .packages import package, rule

CHATTER = rule("ALLOW", "ros_topic", "ros_publish", "/chatter")
TALKER = package(CHATTER)


def documents(loaded=TALKER):
    return build_type.build(loaded, BuildOptions()).documents


def test_the_layout_of_sros2():
    files = build_type.install(TALKER, documents(), credentials(TALKER), "sros2", {})
    assert set(files) == {
        "identity_ca.cert.pem", "permissions_ca.cert.pem", "cert.pem", "key.pem", "governance.p7s",
        "permissions.p7s", "permissions.xml",
    }  # fmt: skip
    assert [name for name, artifact in files.items() if artifact.secret] == ["key.pem"]
    assert files["permissions.xml"].content == documents()["permissions.xml"]
    for kind in ("permissions", "governance"):
        content = smime.verify(files[f"{kind}.p7s"].content, authority("permissions_ca").pem)
        assert content == documents()[f"{kind}.xml"]


def test_the_flat_layout_has_one_authority():
    files = build_type.install(TALKER, documents(), credentials(TALKER, "ca", "ca"), "flat", {})
    assert set(files) == {"ca.cert.pem", "cert.pem", "key.pem", "governance.p7s", "permissions.p7s"}
    with pytest.raises(KeymintError, match="one authority for both"):
        build_type.install(TALKER, documents(), credentials(TALKER), "flat", {})
    with pytest.raises(KeymintError, match="unknown layout 'round'"):
        build_type.install(TALKER, documents(), credentials(TALKER), "round", {})


def test_a_signed_file_is_kept_while_content_and_signer_are_the_same():
    secrets = credentials(TALKER)
    first = build_type.install(TALKER, documents(), secrets, "sros2", {})
    present = {name: artifact.content for name, artifact in first.items()}
    again = build_type.install(TALKER, documents(), secrets, "sros2", present)
    assert {name: artifact.content for name, artifact in again.items()} == present

    other = package(rule("ALLOW", "ros_topic", "ros_publish", "/other"))
    changed = build_type.install(other, documents(other), secrets, "sros2", present)
    assert changed["permissions.p7s"].content != present["permissions.p7s"]
    assert changed["governance.p7s"].content == present["governance.p7s"]

    resigned = build_type.install(TALKER, documents(), credentials(TALKER, permissions="new_ca"), "sros2", present)
    assert resigned["permissions.p7s"].content != present["permissions.p7s"]
    smime.verify(resigned["governance.p7s"].content, authority("new_ca").pem)

    damaged = present | {"permissions.p7s": present["permissions.p7s"].replace(b"chatter", b"chatten")}
    mended = build_type.install(TALKER, documents(), secrets, "sros2", damaged)
    assert smime.verify(mended["permissions.p7s"].content, authority("permissions_ca").pem)


def test_enclaves_share_the_signature_of_the_same_governance():
    listener = package(CHATTER, subject="/listener")
    one, two = (installed(loaded)["governance.p7s"] for loaded in (TALKER, listener))
    assert one == two


@pytest.mark.parametrize(
    ("edit", "place"),
    [
        ((b"<default>", b"<defaults>"), "permissions.xml"),
        ((b"</grant>", b""), "permissions.xml"),
        ((b"DENY", b"PERHAPS"), "expected ALLOW or DENY"),
        ((b"<dds ", b"<!DOCTYPE dds []><dds "), "permissions.xml"),
    ],
)
def test_a_document_that_is_not_valid_is_refused_before_it_is_signed(edit, place):
    edited = {**documents(), "permissions.xml": documents()["permissions.xml"].replace(*edit)}
    with pytest.raises(KeymintError, match=place):
        build_type.install(TALKER, edited, credentials(TALKER), "sros2", {})


def test_a_missing_document_is_an_error_that_says_how_to_get_it():
    with pytest.raises(KeymintError, match="keymint build talker"):
        build_type.install(TALKER, {}, credentials(TALKER), "sros2", {})


def test_a_hand_edited_document_is_signed_as_it_is():
    edited = {**documents(), "permissions.xml": documents()["permissions.xml"].replace(b"rt/chatter", b"rt/gossip")}
    files = build_type.install(TALKER, edited, credentials(TALKER), "sros2", {})
    assert b"rt/gossip" in smime.verify(files["permissions.p7s"].content, authority("permissions_ca").pem)


def artifacts(**subjects):
    return {
        f"/{name}": {file: Artifact(content) for file, content in files.items()} for name, files in subjects.items()
    }


def test_what_all_enclaves_share():
    listener = package(CHATTER, subject="/listener")
    one, two = installed(TALKER), installed(listener)
    shared = build_type.shared(artifacts(talker=one, listener=two), "sros2")
    assert set(shared) == {
        "public/identity_ca.cert.pem", "public/permissions_ca.cert.pem", "enclaves/governance.xml",
        "enclaves/governance.p7s",
    }  # fmt: skip
    assert shared["enclaves/governance.xml"].content == documents()["governance.xml"]
    assert not any(artifact.secret for artifact in shared.values())
    assert build_type.shared(artifacts(talker=one), "flat") == {}
    assert build_type.shared({}, "sros2") == {}
    alone = build_type.shared(artifacts(talker=installed(TALKER, identity="ca", permissions="ca")), "sros2")
    assert alone["public/ca.cert.pem"].content == authority("ca").pem


def test_what_enclaves_do_not_agree_on_is_left_out():
    one, two = installed(TALKER), installed(TALKER, permissions="other_ca")
    two["governance.p7s"] = b"junk"
    assert set(build_type.shared(artifacts(a=one, b=two, c={"other.txt": b""}), "sros2")) == {
        "public/identity_ca.cert.pem"
    }


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs the openssl command")
def test_openssl_verifies_what_is_installed(tmp_path):
    for name, content in installed(TALKER).items():
        (tmp_path / name).write_bytes(content)
    for kind in ("permissions", "governance"):
        subprocess.run(
            ["openssl", "smime", "-verify", "-text", "-in", f"{kind}.p7s", "-CAfile", "permissions_ca.cert.pem"],
            cwd=tmp_path,
            check=True,
            capture_output=True,
        )
