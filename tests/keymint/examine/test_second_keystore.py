# SPDX-License-Identifier: Apache-2.0
"""A second keystore that is staged beside the one in force is judged as if it were that."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint import cli
from tests.conftest import NOW

from .fault_keystores import TALKER
from .presented import codes, findings, for_listener, keystore

VERBS = ("check", "prove")
ENCLAVES = "install.next/enclaves"


@pytest.fixture(scope="module")
def rolled(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with a second keystore, whose permissions another authority signs."""
    folder = tmp_path_factory.mktemp("rolled")
    shutil.copy(made / "policy.xml", folder)
    shutil.copytree(made / "ws", folder / "ws")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
        assert cli.main(["authority", "replace", "permissions_ca", "-w", str(folder / "ws"), "-q"]) == 0
    return folder


@pytest.fixture
def staged(rolled: Path, tmp_path: Path) -> Path:
    shutil.copytree(rolled, tmp_path / "copy", symlinks=True)
    return tmp_path / "copy/ws"


@pytest.mark.parametrize("verb", VERBS)
def test_a_sound_one(keymint, staged: Path, verb: str) -> None:
    assert codes(keymint, staged, verb) == set()


def readable_key(ws: Path) -> None:
    (ws / ENCLAVES / "talker/key.pem").chmod(0o644)


def permissions_of_another(ws: Path) -> None:
    shutil.copy(ws / ENCLAVES / "robot1/listener/permissions.p7s", ws / ENCLAVES / "talker")


def missing_certificate(ws: Path) -> None:
    (ws / ENCLAVES / "talker/cert.pem").unlink()


def grant_for_another(ws: Path) -> None:
    store = keystore(ws)
    store.sign_permissions(TALKER, for_listener(store), "install.next")


def missing_enclave(ws: Path) -> None:
    shutil.rmtree(ws / ENCLAVES / "talker")


def missing_keystore(ws: Path) -> None:
    shutil.rmtree(ws / "install.next")


@pytest.mark.parametrize(
    ("fault", "verbs"),
    [
        (readable_key, ("check",)),  # what a file's mode is, no transport asks
        (permissions_of_another, VERBS),
        (missing_certificate, VERBS),
        (grant_for_another, VERBS),
        (missing_enclave, VERBS),
        (missing_keystore, VERBS),
    ],
)
def test_a_fault_in_it(keymint, staged: Path, fault: Callable[[Path], None], verbs: tuple[str, ...]) -> None:
    fault(staged)
    found = {verb: findings(keymint, staged, verb) for verb in verbs}
    assert all(found.values())
    assert any("install.next" in f"{each['file']} {each['message']}" for each in found["check"])


def open_governance(ws: Path) -> None:
    store = keystore(ws)
    governance = store.governance("install.next")
    for rule in governance.iter("allow_unauthenticated_participants"):
        rule.text = "true"
    store.sign_governance([TALKER], governance, "install.next")


@pytest.mark.parametrize("fault", [missing_certificate, permissions_of_another, grant_for_another, open_governance])
def test_a_finding_names_the_command_that_writes_it(keymint, staged: Path, fault: Callable[[Path], None]) -> None:
    """'keymint install' writes the keystore in force only."""
    fault(staged)
    helps = [str(each["help"]) for verb in VERBS for each in findings(keymint, staged, verb)]
    assert any("'keymint authority replace permissions_ca" in each for each in helps)
    assert not [each for each in helps if "keymint install" in each]
    assert keymint("authority", "replace", "permissions_ca", "-w", staged).code == 0
    assert not any(codes(keymint, staged, verb) for verb in VERBS)


@pytest.mark.parametrize("fault", [missing_enclave, missing_keystore])
def test_what_it_lacks_is_completed_by_the_command_that_the_finding_names(
    keymint, staged: Path, fault: Callable[[Path], None]
) -> None:
    fault(staged)
    (found,) = findings(keymint, staged, "check")
    assert found["code"] == "rollover-incomplete"
    assert "'keymint authority replace permissions_ca'" in str(found["help"])
    assert keymint("authority", "replace", "permissions_ca", "-w", staged).code == 0
    assert codes(keymint, staged, "check") == set()
