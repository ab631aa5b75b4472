# SPDX-License-Identifier: Apache-2.0
"""The files of an installed enclave."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_dds.transports.enclave_files import (
    document_topics,
    refuse_unusable_key,
    signed_documents,
    subject_name,
    unverified_permissions,
)

from comarmor.errors import Origin
from keymint.api import Environment, InstalledEnclave
from keymint.errors import KeymintError
from keymint.pki import smime
from tests.plugins.keymint_ros2_dds.enclaves import NOW, authority, installed
from tests.plugins.keymint_ros2_dds.packages import package, rule

RULES = (
    rule("ALLOW", "ros_topic", "ros_publish", "/b", "/a"),
    rule("ALLOW", "ros_topic", "ros_subscribe", "/a"),
    rule("ALLOW", "topic", "publish", "raw", partitions=("p",)),
)


def write(folder: Path, layout: str = "sros2", **authorities: str) -> InstalledEnclave:
    for name, content in installed(package(*RULES), layout, **authorities).items():
        (folder / name).write_bytes(content)
    return InstalledEnclave("/talker", folder, "humble", folder.parent)


def foreign_signature(folder: Path) -> None:
    ca = authority("other_ca")
    content = smime.signed_content((folder / "permissions.p7s").read_bytes(), Origin("permissions.p7s"))
    (folder / "permissions.p7s").write_bytes(smime.sign(content, ca.certificate, ca.key))


@pytest.mark.parametrize(("layout", "authorities"), [("sros2", {}), ("flat", {"identity": "ca", "permissions": "ca"})])
def test_the_documents_of_both_layouts(tmp_path: Path, layout: str, authorities: dict[str, str]) -> None:
    write(tmp_path, layout, **authorities)
    permissions, governance, name = signed_documents(tmp_path, Environment(NOW, tmp_path))
    assert name == "CN=/talker,OU=x1"
    assert [each.subject_name for each in permissions.grants] == [name]
    assert governance.rule(0) is not None


def test_a_signature_of_another_authority_is_refused_and_not_needed_to_list_topics(tmp_path: Path) -> None:
    enclave = write(tmp_path)
    topics = document_topics(enclave)
    foreign_signature(tmp_path)
    with pytest.raises(KeymintError):
        signed_documents(tmp_path, Environment(NOW, tmp_path))
    assert len(unverified_permissions(tmp_path).grants) == 1
    assert document_topics(enclave) == topics


def test_a_changed_file_is_verified_again(tmp_path: Path) -> None:
    write(tmp_path)
    environment = Environment(NOW, tmp_path)
    first = signed_documents(tmp_path, environment)
    assert signed_documents(tmp_path, environment) is first
    foreign_signature(tmp_path)
    with pytest.raises(KeymintError):
        signed_documents(tmp_path, environment)


def test_each_topic_is_listed_once_with_its_partitions(tmp_path: Path) -> None:
    enclave = write(tmp_path)
    assert sorted(document_topics(enclave)) == [("raw", ("p",)), ("rt/a", ()), ("rt/b", ())]
    (tmp_path / "permissions.p7s").write_bytes(b"garbage")
    assert document_topics(enclave) == ()


@pytest.mark.parametrize("name", ["permissions.p7s", "governance.p7s", "cert.pem", "permissions_ca.cert.pem"])
def test_a_missing_file_is_an_error_with_its_path(tmp_path: Path, name: str) -> None:
    write(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(KeymintError) as caught:
        signed_documents(tmp_path, Environment(NOW, tmp_path))
    (diagnostic,) = caught.value.diagnostics
    assert diagnostic.code == "enclave-file"
    assert diagnostic.where is not None
    assert Path(diagnostic.where.file).parent == tmp_path


def test_bytes_that_are_no_certificate_have_no_subject() -> None:
    with pytest.raises(KeymintError):
        subject_name(b"garbage", Origin("cert.pem"))


def test_a_key_that_is_encrypted_or_in_a_token_is_refused(tmp_path: Path) -> None:
    enclave = write(tmp_path)
    refuse_unusable_key(enclave)
    (tmp_path / "key.pem").write_bytes(b"-----BEGIN ENCRYPTED PRIVATE KEY-----\n")
    with pytest.raises(KeymintError) as caught:
        refuse_unusable_key(enclave)
    assert caught.value.diagnostics[0].code == "key-encrypted"
    (tmp_path / "key.pem").unlink()
    refuse_unusable_key(enclave)
    (tmp_path / "key.p11").write_bytes(b"pkcs11:token=robot;object=talker\n")
    with pytest.raises(KeymintError) as caught:
        refuse_unusable_key(enclave)
    assert caught.value.diagnostics[0].code == "key-in-token"
