# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: who else can write what lies in the workspace, and what does not belong there."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

Damage = Callable[[Path], object]
KEY = "private/identities/talker/key.pem"


def chmod(name: str, mode: int) -> Damage:
    return lambda ws: (ws / name).chmod(mode)


def chown(name: str) -> Damage:
    return lambda ws: os.chown(ws / name, 12345, -1)


def link(name: str) -> Damage:
    return lambda ws: os.link(ws / name, ws.parent / "another_name")


def fifo(name: str) -> Damage:
    return lambda ws: os.mkfifo(ws / name)


def bind(name: str) -> Damage:
    def make(ws: Path) -> None:
        place = socket.socket(socket.AF_UNIX)
        folder = os.open(ws / name, os.O_RDONLY)
        place.bind(f"/proc/self/fd/{folder}/s")
        place.close()
        os.close(folder)

    return make


def folder(name: str) -> Damage:
    return lambda ws: (ws / name).mkdir(parents=True)


def moved(name: str) -> Damage:
    def move(ws: Path) -> None:
        (ws / name).rename(ws.parent / "elsewhere")
        (ws / name).symlink_to(ws.parent / "elsewhere")

    return move


AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
OURS, THEIRS = ("install", "install/enclaves", "install/public"), (".", "build", "build/talker", "public", ".keymint")
PRIVATE = ("private", "private/identities", "private/identities/robot1")
SOURCES = ("profile", "profile/package.defaults", "src", "src/talker")
KEYS = (KEY, "private/identity_ca.key.pem", "install/enclaves/talker/key.pem")
OWNED = (*KEYS, *OURS, *PRIVATE, "install/enclaves/talker/cert.pem", "src/talker", "profile/policies.xml")
PIPES = ("install/p", "install/enclaves/talker/p", "private/p")
EMPTY = ("install/x", "install/enclaves/talker/x", "install/.x")
DAMAGES = [
    *((name, "place-writable", chmod(name, mode)) for name in OURS for mode in (0o777, 0o775, 0o757)),
    *((name, "place-writable", chmod(name, 0o777)) for name in (*THEIRS, *SOURCES)),
    ("src/talker/permissions.xml", "place-writable", chmod("src/talker/permissions.xml", 0o666)),
    ("profile/authorities.xml", "place-writable", chmod("profile/authorities.xml", 0o646)),
    ("public/identity_ca.cert.pem", "place-writable", chmod("public/identity_ca.cert.pem", 0o666)),
    *((name, "file-mode", chmod(name, 0o711)) for name in PRIVATE),
    (KEY, "file-mode", chmod(KEY, 0o604)),
    *(pytest.param(name, "file-owner", chown(name), marks=AS_ROOT) for name in OWNED),
    *((name, "key-linked", link(name)) for name in KEYS),
    *((name, "file-kind", fifo(name)) for name in PIPES),
    ("install/s", "file-kind", bind("install")),
    *((name, "folder-unexpected", folder(name)) for name in EMPTY),
    ("private/identities", "file-link", moved("private/identities")),
    ("install/public", "file-unexpected", moved("install/public")),
]


@pytest.mark.parametrize(
    ("name", "code", "damage"),
    DAMAGES,
)
def test_is_found(keymint, ws: Path, name: str, code: str, damage: Damage) -> None:
    damage(ws)
    outcome = keymint("check", "--json", cwd=ws)
    assert outcome.code == 3
    found = {(each["code"], each["file"]) for each in outcome.document["diagnostics"]}
    assert (code, name) in found, found


def test_a_group_of_one_person_is_no_finding(keymint, ws: Path) -> None:
    """Distributions give every user a group of their own, and a umask of 002: git makes such files."""
    for path in (ws / "profile", ws / "src", *(ws / "src").rglob("*"), *(ws / "profile").rglob("*")):
        path.chmod(0o775 if path.is_dir() else 0o664)
    assert keymint("check", cwd=ws).code == 0
    if os.geteuid() == 0:
        os.chown(ws / "src/talker", -1, 12345)
        assert keymint("check", cwd=ws).code == 3


def test_what_is_said_to_mend_it_mends_it(keymint, ws: Path) -> None:
    import subprocess

    for name in ("install", "src", "src/talker", "private/identities", "profile/authorities.xml"):
        (ws / name).chmod(0o777)
    outcome = keymint("check", "--json", cwd=ws)
    for each in outcome.document["diagnostics"]:
        subprocess.run(each["help"].split(), cwd=ws, check=True)
    assert keymint("check", cwd=ws).code == 0


def test_many_files_are_one_finding(keymint, ws: Path) -> None:
    """A build machine without a umask makes all files writable by all."""
    for path in (ws / "src").rglob("*"):
        path.chmod(0o777)
    outcome = keymint("check", "--json", cwd=ws)
    assert outcome.codes() == ["place-writable"]
    assert "more below it or beside it" in outcome.document["diagnostics"][0]["message"]
