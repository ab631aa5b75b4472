# SPDX-License-Identifier: Apache-2.0
"""What a keystore on a robot has, in either layout."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.errors import KeymintError
from keymint.examine.bundles import Owner, accept
from keymint.pki import keys
from keymint.robots import certification_request
from keymint.robots.robot_keystore import Keystore
from keymint.store.changes import FolderChange
from keymint.store.store import Store

from .conftest import AT, FILE, NONCE, Made, authority, robot_key

FIRST = Made(nonce=NONCE)
GIVEN = Owner(frozenset({keys.fingerprint(authority().key)}))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "keystore"


def read(root: Path) -> Keystore:
    return Keystore(root, "keystore")


def write(root: Path, *changes: FolderChange) -> None:
    Store({root: False}, root / ".keymint").change(changes)


def waiting(root: Path, name: str = "robot/talker", *, key: bool = True) -> bytes:
    content = certification_request.make(f"/{name}", robot_key("talker"), NONCE)
    write(root, read(root).wait(name, content, keys.to_pem(robot_key("talker")) if key else b""))
    return content


def test_nothing_is_there(root: Path) -> None:
    present = read(root).present("enclaves", "robot/talker")
    assert (present.files, present.pending, present.known) == ({}, None, {})
    assert present.folder == "keystore/enclaves/robot/talker"
    assert not read(root).installed("robot/talker")
    assert not root.exists()


def test_a_request_waits_with_its_key(root: Path) -> None:
    content = waiting(root)
    folder = root / ".keymint/requests/robot/talker"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert (folder / "key.pem").stat().st_mode & 0o777 == 0o600
    pending = read(root).present("enclaves", "robot/talker").pending
    assert pending is not None
    assert pending.request == certification_request.read(content, FILE)
    assert pending.key == keys.to_pem(robot_key("talker"))
    assert read(root).request("robot/talker") == content
    assert read(root).request("robot") is None


def test_another_request_replaces_it_with_its_key(root: Path) -> None:
    waiting(root)
    waiting(root, key=False)
    pending = read(root).pending("robot/talker")
    assert pending is not None
    assert pending.key == b""


def test_requests_of_nested_names(root: Path) -> None:
    waiting(root, "robot")
    waiting(root, "robot/talker")
    write(root, read(root).forget("robot"))
    assert read(root).request("robot") is None
    assert read(root).request("robot/talker")
    write(root, read(root).forget("robot/talker"))
    assert not (root / ".keymint/requests/robot").exists()


def test_a_damaged_request_is_an_error(root: Path) -> None:
    waiting(root)
    (root / ".keymint/requests/robot/talker/request.pem").write_bytes(b"x")
    with pytest.raises(KeymintError) as refused:
        read(root).pending("robot/talker")
    where = refused.value.diagnostics[0].where
    assert where is not None
    assert where.file == "keystore/.keymint/requests/robot/talker/request.pem"


@pytest.mark.parametrize("enclaves", ["enclaves", ""])
def test_what_is_accepted_is_present(root: Path, enclaves: str) -> None:
    waiting(root)
    store = read(root)
    acceptance = accept(FIRST.bundle, store.present(enclaves, "robot/talker"), GIVEN, AT, FILE)
    write(root, store.take(enclaves, "robot/talker", acceptance.files, acceptance.removed))
    folder = root / enclaves / "robot/talker"
    assert {path.name for path in folder.iterdir()} == set(FIRST.installed())
    assert {path.name for path in folder.iterdir() if path.stat().st_mode & 0o077 == 0} == {"key.pem"}
    present = read(root).present(enclaves, "robot/talker")
    assert present.files == FIRST.installed()
    assert read(root).installed("robot/talker") == FIRST.installed()
    assert set(present.known) == {"identity_ca.cert.pem", "permissions_ca.cert.pem"}
    # Another enclave knows the same authorities.
    assert read(root).present(enclaves, "other").known == present.known


def test_what_cannot_be_read_is_trusted_by_nobody(root: Path) -> None:
    folder = root / "enclaves/robot"
    folder.mkdir(parents=True)
    for name, content in FIRST.files.items():
        (folder / name).write_bytes(content)
    (folder / "identity_ca.cert.pem").write_bytes(b"-----BEGIN CERTIFICATE-----\nx\n")
    (folder / "linked.pem").symlink_to(folder / "permissions_ca.cert.pem")
    assert set(read(root).present("enclaves", "robot/talker").known) == {"permissions_ca.cert.pem"}


def test_a_link_is_refused(root: Path) -> None:
    (root / "enclaves").mkdir(parents=True)
    folder = root / "enclaves/talker"
    folder.mkdir()
    (folder / "cert.pem").symlink_to("/etc/passwd")
    with pytest.raises(KeymintError) as refused:
        read(root).present("enclaves", "talker")
    assert refused.value.diagnostics[0].code == "symlink-refused"
