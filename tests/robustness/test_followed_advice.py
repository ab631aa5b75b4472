# SPDX-License-Identifier: Apache-2.0
"""The command in the help of an error is executed: it brings progress, and no chain of advice is a circle.

Here for what once ended in a circle, or could; with ``KEYMINT_FULL=1`` for each error that any test meets
(``tests/advice.py``, called by the fixture ``keymint``).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from keymint.pki import certificates
from tests import advice
from tests.robustness import scenarios
from tests.robustness.scenarios import PROVISION as _PROVISION

WS = " -w ws"
REVOKE = "revoke listener --reason superseded" + WS
PROVISION = " ".join(_PROVISION).replace("{}/", "")
Step = str | Callable[[Path], None]


def without(*names: str) -> Callable[[Path], None]:
    """Return what removes files and folders."""

    def remove(folder: Path) -> None:
        for name in names:
            path = folder / "ws" / name
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()

    return remove


def damaged(*names: str) -> Callable[[Path], None]:
    """Return what damages files."""

    def damage(folder: Path) -> None:
        for name in names:
            path = folder / "ws" / name
            path.write_bytes(path.read_bytes()[:-20])

    return damage


def narrower(folder: Path) -> None:
    policy = folder / "policy.xml"
    policy.write_text(policy.read_text().replace("/chatter", "/chatter_of_today"))


def without_listener(folder: Path) -> None:
    (folder / "policy.xml").write_text(scenarios.policy("/robot/talker"))


def another_subject(folder: Path) -> None:
    (folder / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener", "/camera"))


def another_authority(folder: Path) -> None:
    """Write an authority of another tool, which has no key here."""
    shutil.copy(folder / "other/public/identity_ca.cert.pem", folder / "ca.pem")
    shutil.copy(folder / "other/private/identity_ca.key.pem", folder / "ca.key")


def edited(folder: Path) -> None:
    file = folder / "ws/src/listener/permissions.xml"
    file.write_text(file.read_text().replace("/chatter", "/chat*"))


def elsewhere(folder: Path) -> None:
    shutil.copytree(folder / "ws/install/enclaves/robot/talker", folder / "ws/install/enclaves/stranger")


OTHER = PROVISION.replace("ws", "other")
REPLACE = "authority replace identity_ca" + WS
CASES: Mapping[str, tuple[Sequence[Step], str]] = {
    "no workspace": ((), "check -w ws"),
    "revoked, then renewed": (("revoke listener --reason retired" + WS,), "renew listener" + WS),
    "revoked, then bundled": (("revoke listener --reason retired" + WS,), "bundle listener -o b" + WS),
    "a key is gone": ((without("install/enclaves/listener/key.pem"),), "check" + WS),
    "an enclave is gone": ((without("install/enclaves/listener"),), "check" + WS),
    "a certificate is damaged": ((damaged("install/enclaves/listener/cert.pem"),), "check" + WS),
    "permissions are damaged": ((damaged("install/enclaves/listener/permissions.p7s"),), "prove" + WS),
    "the common governance is gone": ((without("install/enclaves/governance.p7s"),), "check" + WS),
    "a list is gone": (
        (REVOKE, without("install/enclaves/robot/talker/crl.pem")),
        "check" + WS,
    ),
    "the register is gone": (
        (REVOKE, without("private/register.sqlite3")),
        "check" + WS,
    ),
    "the register is damaged": ((damaged("private/register.sqlite3"),), "renew listener" + WS),
    "the built documents are gone": ((without("build"),), "install" + WS),
    "nothing is built of a package": ((without("build/listener"),), "bundle listener -o b" + WS),
    "sources are edited, then bundled": ((edited,), "bundle listener -o b" + WS),
    "an enclave without sources": ((elsewhere,), "check" + WS),
    "the key of the authority is gone": ((without("private/identity_ca.key.pem"),), "renew --rekey listener" + WS),
    "the authority is gone": (
        (without("private/identity_ca.key.pem", "public/identity_ca.cert.pem"),),
        "install" + WS,
    ),
    "another authority": ((OTHER, another_authority), "authority import identity_ca ca.pem" + WS),
    "another authority, with its key": (
        (OTHER, another_authority),
        "authority import identity_ca ca.pem --key ca.key" + WS,
    ),
    "a second keystore is staged": ((REPLACE,), "authority renew identity_ca" + WS),
    "a staged keystore is old": ((REPLACE, narrower, PROVISION), f"{REPLACE} --phase end"),
    "a staged keystore is incomplete": ((REPLACE, without("install.next/enclaves/listener/cert.pem")), "check" + WS),
    "a phase out of order": ((REPLACE,), f"{REPLACE} --phase reissue"),
    "no phase to follow": ((), f"{REPLACE} --phase reissue"),
}


def prepared(folder: Path, steps: Sequence[Step]) -> None:
    (folder / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener"))
    for step in steps:
        if callable(step):
            step(folder)
        else:
            status, printed = advice.once([*step.split(), "--json"], folder)
            assert status == 0, printed


@pytest.mark.parametrize("name", CASES)
def test_what_an_error_advises_brings_progress(name: str, tmp_path: Path) -> None:
    steps, line = CASES[name]
    folder = tmp_path / "here"
    folder.mkdir()
    prepared(folder, (PROVISION, *steps) if name != "no workspace" else steps)
    status, printed = advice.once([*line.split(), "--json"], folder)
    assert status, printed
    found = list(advice.follow(line.split(), folder, advice.once))
    assert found
    assert [each for each in found if each.is_wrong] == []


def test_a_next_authority_without_its_key_stages_nothing(tmp_path: Path) -> None:
    prepared(tmp_path, (PROVISION, OTHER, another_authority))
    line = [*REPLACE.split(), "--certificate", "ca.pem", "--json"]
    status, printed = advice.once(line, tmp_path)
    assert status == 1
    (error,) = advice.errors_of(printed)
    assert (error["code"], error["file"], error["help"]) == (
        "authority-key-missing",
        "ca.pem",
        "give it with --key FILE",
    )
    assert advice.once([*line, "--key", "ca.key"], tmp_path)[0] == 0
    staged = certificates.load((tmp_path / "ws/install.next/enclaves/listener/identity_ca.cert.pem").read_bytes())
    assert staged == certificates.load((tmp_path / "ca.pem").read_bytes())


@pytest.mark.parametrize(
    ("text", "by_hand", "commands"),
    [
        ("'keymint install' restores it", "", [["install"]]),
        ("run 'keymint build a' and 'keymint install a' first", "run", [["build", "a"], ["install", "a"]]),
        ("restore it, or remove it and run 'keymint install'", "remove it and run", [["install"]]),
        ("restore it", None, None),
    ],
)
def test_what_is_read_of_a_help(text: str, by_hand: str | None, commands: Sequence[Sequence[str]] | None) -> None:
    found = advice.advice_in(text)
    assert (found and found.by_hand, found and [[*each] for each in found.commands]) == (by_hand, commands)


def circular(line: Sequence[str], _folder: Path) -> tuple[int, str]:
    """Answer as a tool would whose errors send one another round."""
    following = {"install": "renew", "renew": "install"}[line[0]]
    error = {"code": "x", "severity": "error", "file": None, "message": line[0], "help": f"run 'keymint {following}'"}
    return 1, json.dumps({"diagnostics": [error]})


def test_a_circle_is_seen(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (found,) = advice.follow(["install"], tmp_path / "here", circular)
    assert (found.outcome, found.is_wrong) == ("a circle", True)
