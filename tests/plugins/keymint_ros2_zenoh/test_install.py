# SPDX-License-Identifier: Apache-2.0
"""The install stage: the files of an enclave, and a detached signature that openssl verifies."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from keymint_ros2_zenoh import build_type

from keymint.api import Credentials
from keymint.errors import KeymintError
from tests.conftest import CHECKOUT

from .enclaves import OPTIONS, authority, credentials, pem, shared, signer
from .workspaces import LISTENER, TALKER, workspace

PACKAGES = workspace(TALKER, LISTENER)
ROUTER, SIGNATURE = "zenoh/router.json5", "zenoh/router.json5.p7s"


def install_shared(documents, installed, by: str = "permissions_ca"):
    secrets = Credentials({"access": signer(by).certificate}, {"access": signer(by)})
    artifacts = build_type.install_shared(PACKAGES, documents, secrets, "sros2", installed)
    return {name: artifact.content for name, artifact in artifacts.items()}


@pytest.mark.parametrize(("number", "more"), [(0, {"session.json5"}), (1, {"session.json5"}), (2, set())])
def test_the_files_of_an_enclave(number: int, more: set[str]) -> None:
    package = PACKAGES[number]
    documents = build_type.build(package, OPTIONS).documents
    secrets = credentials(package)
    files = build_type.install(package, documents, secrets, "sros2", {})
    assert set(files) == {"cert.pem", "key.pem", "identity_ca.cert.pem", *more} <= build_type.files("sros2")
    assert [name for name, artifact in files.items() if artifact.secret] == ["key.pem"]
    assert files["cert.pem"].content == secrets.certificate
    assert files["identity_ca.cert.pem"].content == secrets.chains["identity"]
    assert {name: files[name].content for name in documents} == documents


def test_what_is_not_installed() -> None:
    talker = PACKAGES[1]
    with pytest.raises(KeymintError, match=r"there is no talker/session\.json5") as own:
        build_type.install(talker, {}, credentials(talker), "sros2", {})
    assert own.value.diagnostics[0].help == "run 'keymint build talker'"
    with pytest.raises(KeymintError, match=r"there is no zenoh/router\.json5") as shared:
        install_shared({}, {})
    assert shared.value.diagnostics[0].help == "run 'keymint build'"
    with pytest.raises(KeymintError, match="must be one of"):
        build_type.install(talker, {"session.json5": b"{mode: 'clint'}"}, credentials(talker), "sros2", {})
    assert build_type.files("flat") == frozenset()
    assert build_type.shared({}, "sros2") == {}


def test_a_signature_is_kept_while_content_and_signer_are_the_same() -> None:
    documents = build_type.build_shared(PACKAGES, OPTIONS).documents
    first = install_shared(documents, {})
    assert install_shared(documents, first) == first
    changed = {ROUTER: documents[ROUTER].replace(b"chatter", b"chatten")}
    assert install_shared(changed, first)[SIGNATURE] != first[SIGNATURE]
    assert install_shared(documents, first, by="other_ca")[SIGNATURE] != first[SIGNATURE]
    assert install_shared(documents, {**first, SIGNATURE: b"?"})[SIGNATURE] not in {b"?", first[SIGNATURE]}


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_openssl_verifies_the_signature(tmp_path: Path) -> None:
    files = shared(PACKAGES)
    (tmp_path / "router.json5").write_bytes(files[ROUTER])
    (tmp_path / "router.json5.p7s").write_bytes(files[SIGNATURE])
    (tmp_path / "ca.pem").write_bytes(pem("permissions_ca"))
    (tmp_path / "other.pem").write_bytes(pem("other_ca"))
    assert authority("other_ca") is not authority("permissions_ca")

    def verified(ca: str) -> bool:
        options = ["-binary", "-inform", "DER", "-in", "router.json5.p7s", "-content", "router.json5", "-CAfile", ca]
        command = ["openssl", "cms", "-verify", *options, "-no_check_time", "-out", "/dev/null"]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode == 0

    assert verified("ca.pem")
    assert not verified("other.pem")
    (tmp_path / "router.json5").write_bytes(files[ROUTER] + b"\n")
    assert not verified("ca.pem")


def test_a_missing_key_of_the_signer_is_named_by_its_own_path(keymint, tmp_path: Path) -> None:
    policy = CHECKOUT / "examples/talker_listener/talker_listener.xml"
    assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh").code == 0
    (tmp_path / "ws/private/permissions_ca.key.pem").unlink()
    defaults = tmp_path / "ws/profile/package.defaults/zenoh.xml"
    defaults.write_text(defaults.read_text().replace("7447", "7448"))
    assert keymint("build", "-w", "ws").code == 0
    refused = keymint("install", "-w", "ws", "--json")
    missing = [each["file"] for each in refused.document["diagnostics"] if each["code"] == "authority-key-missing"]
    assert missing == ["ws/private/permissions_ca.key.pem"]
