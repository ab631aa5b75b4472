# SPDX-License-Identifier: Apache-2.0
"""Documents over all packages of a build type, beside the build type of DDS in one workspace."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from keymint import cli
from keymint.pki import smime
from keymint.store import group_commit
from keymint.store.staged import Exchange
from tests.conftest import NOW, snapshot
from tests.keymint.conftest import POLICY
from tests.keymint.notice_board import BOARD, NAME, NOTE, SIGNATURE, register

TALKER, LISTENER = "/talker", "/robot1/listener"
DDS = "<build_type>keymint_ros2_dds</build_type>"


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("plugin")
    register(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, plugin: None) -> Path:
    """A workspace whose packages have both build types, installed and proven."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "policy.xml").write_text(POLICY)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
        patch.setenv("KEYMINT_TRACEBACK", "1")
        run = ["-w", str(folder / "ws")]
        assert cli.main(["init", "--policy", str(folder / "policy.xml"), str(folder / "ws")]) == 0
        assert cli.main(["create", "--all", *run]) == 0
        for name in ("talker", "robot1/listener"):
            add_build_type(folder / "ws", name)
        assert cli.main(["build", *run]) == 0
        assert cli.main(["install", *run]) == 0
    return folder


@pytest.fixture
def ws(made: Path, tmp_path: Path) -> Path:
    shutil.copy(made / "policy.xml", tmp_path / "policy.xml")
    return shutil.copytree(made / "ws", tmp_path / "ws")


def add_build_type(ws: Path, name: str, *, alone: bool = False) -> None:
    manifest = ws / "src" / name / "keymint_package.xml"
    text = manifest.read_text()
    assert DDS in text
    manifest.write_text(text.replace(DDS, f"{'' if alone else DDS}<build_type>{NAME}</build_type>"))


def board(ws: Path, space: str = "install") -> dict[str, list[str]]:
    return json.loads((ws / (space if space == "install" else "build/shared.d") / BOARD).read_text())


def signed(ws: Path) -> bytes:
    ca = (ws / "public/permissions_ca.cert.pem").read_bytes()
    return smime.verify((ws / "install" / SIGNATURE).read_bytes(), ca)


def change(ws: Path, name: str = "talker") -> None:
    """Change the rights of a package in its sources."""
    rules = ws / "src" / name / "permissions.xml"
    assert "/chatter" in rules.read_text()
    rules.write_text(rules.read_text().replace("/chatter", "/gossip"))


def test_both_build_types_share_the_enclave(ws: Path) -> None:
    enclave = {path.name for path in (ws / "install/enclaves/talker").iterdir()}
    assert {NOTE, "permissions.p7s", "governance.p7s", "cert.pem", "key.pem", "identity_ca.cert.pem"} <= enclave
    built = {path.name for path in (ws / "build/talker").iterdir()}
    assert {NOTE, "permissions.xml", "governance.xml"} <= built


def test_the_rights_of_all_packages_are_signed_once(ws: Path) -> None:
    assert board(ws).keys() == {TALKER, LISTENER}
    assert board(ws) == board(ws, "build")
    assert signed(ws) == (ws / "install" / BOARD).read_bytes()


def test_a_second_run_changes_nothing(keymint, ws: Path) -> None:
    assert keymint("build", cwd=ws).code == 0  # the copy of the workspace is another place
    assert keymint("install", cwd=ws).code == 0
    before = snapshot(ws)
    for verb in ("build", "install"):
        outcome = keymint(verb, "--json", cwd=ws)
        assert {step["action"] for step in outcome.document["steps"]} == {"unchanged"}
    assert {path: entry for path, entry in snapshot(ws).items() if not path.startswith(".keymint")} == {
        path: entry for path, entry in before.items() if not path.startswith(".keymint")
    }


def test_the_place_of_the_install_space_is_an_input(keymint, ws: Path) -> None:
    keymint("build", cwd=ws)
    keymint("install", cwd=ws)
    [row] = keymint("status", "--json", cwd=ws).document["result"]["shared"]
    assert row["stale"] is None
    [row] = keymint("status", "--json", cwd=shutil.copytree(ws, ws.parent / "moved")).document["result"]["shared"]
    assert row["stale"] == "build"


@pytest.mark.parametrize("other", ["talker", "robot1/listener"])
def test_a_run_for_one_package_brings_the_document_up_to_date(keymint, ws: Path, other: str) -> None:
    change(ws)
    assert keymint("build", other, cwd=ws).code == 0
    assert any("/gossip" in line for line in board(ws, "build")[TALKER])
    assert not any("/gossip" in line for line in board(ws)[TALKER])
    assert keymint("install", other, "--no-prove", cwd=ws).code == 0
    assert board(ws) == board(ws, "build")
    assert signed(ws) == (ws / "install" / BOARD).read_bytes()


def test_only_packages_of_the_build_type_are_in_it(keymint, ws: Path) -> None:
    manifest = ws / "src/talker/keymint_package.xml"
    manifest.write_text(manifest.read_text().replace(f"<build_type>{NAME}</build_type>", ""))
    assert keymint("build", "talker", cwd=ws).code == 0
    assert board(ws, "build").keys() == {LISTENER}
    assert not (ws / "build/talker" / NOTE).exists()
    assert keymint("install", cwd=ws).code == 0
    assert board(ws).keys() == {LISTENER}
    enclave = {path.name for path in (ws / "install/enclaves/talker").iterdir()}
    assert "permissions.p7s" in enclave
    assert NOTE not in enclave


def test_a_new_package_is_admitted_before_its_enclave_is_there(keymint, ws: Path) -> None:
    (ws.parent / "policy.xml").write_text(
        POLICY.replace("/talker<", "/second<").replace("</profiles>", "") + "</profiles>"
    )
    assert keymint("create", "second", cwd=ws).code == 0
    add_build_type(ws, "second")
    assert keymint("build", "second", cwd=ws).code == 0
    outcome = keymint("install", "second", "--no-prove", "--json", "--dry-run", cwd=ws)
    steps = [(step["stage"], step["package"], step["action"]) for step in outcome.document["steps"]]
    steps = [step for step in steps if step[0] == "install" and step[2] != "unchanged"]
    assert steps.index(("install", "", "updated")) < steps.index(("install", "second", "created"))


def test_it_is_written_before_any_enclave(keymint, ws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a run is killed: the rights of a removed subject end first."""
    visible: list[str] = []
    make_visible = group_commit.make_visible

    def seen(folder: int, exchange: Exchange) -> str | None:
        visible.append(f"{exchange.folder}/{exchange.name}".removeprefix(f"{ws}/"))
        return make_visible(folder, exchange)

    shutil.rmtree(ws / "src/talker")
    change(ws, "robot1/listener")
    assert keymint("build", cwd=ws).code == 0
    monkeypatch.setattr(group_commit, "make_visible", seen)
    assert keymint("install", "--prune", "--no-prove", cwd=ws).code == 0
    installed = [each for each in visible if each.startswith("install/")]
    assert {"install/enclaves/talker", "install/enclaves/robot1/listener"} <= {*installed}
    assert installed[0].startswith("install/board")


def test_a_removed_package_leaves_it_before_its_enclave_is_removed(keymint, ws: Path) -> None:
    shutil.rmtree(ws / "src/talker")
    refused = keymint("install", "--prune", "--no-prove", cwd=ws)
    assert refused.code == 1
    assert f"build/shared.d/{BOARD}: error: is stale, and may still have the rights of /talker" in refused.err
    assert TALKER in board(ws)
    assert (ws / "install/enclaves/talker/key.pem").exists()
    assert keymint("build", cwd=ws).code == 0
    outcome = keymint("install", "--prune", "--no-prove", "--json", cwd=ws)
    assert outcome.code == 0, outcome.err
    done = [(step["package"], step["action"]) for step in outcome.document["steps"] if step["action"] != "unchanged"]
    assert done[0][1] == "updated"
    assert done[-1] == ("talker", "removed")
    assert board(ws).keys() == {LISTENER}


def test_without_packages_the_document_goes(keymint, ws: Path) -> None:
    for name in ("talker", "robot1/listener"):
        manifest = ws / "src" / name / "keymint_package.xml"
        manifest.write_text(manifest.read_text().replace(f"<build_type>{NAME}</build_type>", ""))
    assert keymint("build", cwd=ws).code == 0
    assert not (ws / "build/shared.d").exists()
    assert keymint("install", cwd=ws).code == 0
    assert not (ws / "install/board").exists()
    assert keymint("status", "--json", cwd=ws).document["result"]["shared"] == []


def test_a_package_with_defects_prevents_it(keymint, ws: Path) -> None:
    change(ws)
    (ws / "src/robot1/listener/identities.xml").write_text("<identities>")
    outcome = keymint("build", "talker", cwd=ws)
    assert outcome.code == 1
    assert f"the sources of {LISTENER} have defects, so the shared documents of {NAME} cannot be built" in outcome.err
    assert "identities.xml" in outcome.err


class TestManualEdits:
    def edit(self, ws: Path) -> None:
        path = ws / "build/shared.d" / BOARD
        path.write_text(path.read_text().replace("/chatter", "/mine"))

    def test_are_kept_and_signed_with_a_warning(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        self.edit(ws)
        assert f"{BOARD} edited by hand; -f rebuilds" in keymint("build", cwd=ws).out
        outcome = keymint("install", "--no-prove", cwd=ws)
        assert outcome.code == 0
        assert f"build/shared.d/{BOARD}: warning: was edited by hand; signing the edited document" in outcome.err
        assert b"/mine" in signed(ws)

    def test_are_not_overwritten_when_the_sources_change(self, keymint, ws: Path) -> None:
        self.edit(ws)
        change(ws)
        outcome = keymint("build", "robot1/listener", cwd=ws)
        assert outcome.code == 1
        assert f"build/shared.d/{BOARD}: error: was edited by hand, so nothing is built in its place" in outcome.err
        assert keymint("build", "-f", cwd=ws).code == 0
        assert "/mine" not in (ws / "build/shared.d" / BOARD).read_text()

    def test_are_not_installed_if_they_change_the_rights(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        keymint("install", cwd=ws)
        before = signed(ws)
        self.edit(ws)
        outcome = keymint("install", cwd=ws)
        assert outcome.code == 3
        assert f"build/shared.d/{BOARD}: error: a manual edit changes what the subjects may do" in outcome.err
        assert signed(ws) == before

    def test_that_concern_an_enclave_that_stays_are_refused_too(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        keymint("install", cwd=ws)
        path = ws / "build/shared.d" / BOARD
        path.write_text(json.dumps({**board(ws), LISTENER: []}))
        outcome = keymint("install", "talker", cwd=ws)
        assert outcome.code == 3
        assert f"{LISTENER}: the document permits it" in outcome.err
        assert board(ws)[LISTENER] != []


class TestStatus:
    def shared(self, keymint, ws: Path) -> dict[str, object]:
        [row] = keymint("status", "--json", cwd=ws).document["result"]["shared"]
        return row

    def test_tells_when_it_is_stale(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        keymint("install", cwd=ws)
        fresh = {"build_type": NAME, "documents": [BOARD], "stage": "installed", "stale": None, "problem": None}
        assert self.shared(keymint, ws) == fresh
        (ws / "install" / SIGNATURE).unlink()
        assert self.shared(keymint, ws) == {**fresh, "stale": "install"}
        change(ws)
        assert self.shared(keymint, ws)["stale"] == "build"
        assert f"{BOARD}  " in keymint("status", cwd=ws).out

    def test_of_a_package_with_defects(self, keymint, ws: Path) -> None:
        (ws / "src/talker/identities.xml").write_text("<identities>")
        assert "cannot be built" in str(self.shared(keymint, ws)["problem"])


class TestCheck:
    def found(self, keymint, ws: Path) -> set[tuple[str, str]]:
        return {
            (each["code"], each["file"])
            for each in keymint("check", "--json", cwd=ws).document["diagnostics"]
            if each["severity"] != "note"
        }

    def test_of_what_is_installed_finds_nothing(self, keymint, ws: Path) -> None:
        assert self.found(keymint, ws) == set()
        (ws / ".keymint/state.json").unlink()
        assert self.found(keymint, ws) == set()

    def test_a_changed_board(self, keymint, ws: Path) -> None:
        path = ws / "install" / BOARD
        path.write_text(path.read_text().replace("/chatter", "/mine"))
        assert self.found(keymint, ws) == {
            ("file-changed", f"install/{BOARD}"),
            ("board-unsigned", f"install/{SIGNATURE}"),
            ("counterexample", None),
        }

    @pytest.mark.parametrize("file", [BOARD, SIGNATURE])
    def test_a_missing_file(self, keymint, ws: Path, file: str) -> None:
        (ws / "install" / file).unlink()
        assert ("file-missing", f"install/{file}") in self.found(keymint, ws)
        assert keymint("install", cwd=ws).code == 0
        assert self.found(keymint, ws) == set()

    def test_a_mode(self, keymint, ws: Path) -> None:
        (ws / "install" / BOARD).chmod(0o666)
        assert ("file-mode", f"install/{BOARD}") in self.found(keymint, ws)
        assert keymint("install", cwd=ws).code == 0
        assert self.found(keymint, ws) == set()

    def test_a_stale_board(self, keymint, ws: Path) -> None:
        change(ws)
        assert ("board-stale", f"install/{SIGNATURE}") in self.found(keymint, ws)

    def test_a_foreign_file_beside_it(self, keymint, ws: Path) -> None:
        (ws / "install/board/other").touch()
        assert self.found(keymint, ws) == {("file-unexpected", "install/board/other")}

    def test_each_build_type_checks_its_own_files(self, keymint, ws: Path) -> None:
        (ws / "install/enclaves/talker" / NOTE).write_text("else")
        assert ("note-differs", f"install/enclaves/talker/{NOTE}") in self.found(keymint, ws)


class TestProve:
    def shared(self, outcome) -> dict[str, object]:
        [proof] = [each for each in outcome.document["result"]["shared"] if each["build_type"] == NAME]
        return proof

    def test_claims_of_all_build_types_and_across_subjects(self, keymint, ws: Path) -> None:
        outcome = keymint("prove", "--json", cwd=ws)
        assert outcome.code == 0, outcome.out
        for enclave in outcome.document["result"]["enclaves"]:
            assert {"omg", "board"} <= {claim["model"] for claim in enclave["claims"]}
        proof = self.shared(outcome)
        assert (proof["build_type"], proof["subject"], proof["proof"]) == (NAME, None, "proven")
        assert [claim["action"] for claim in proof["claims"]] == ["have a package"]
        assert "board" in outcome.document["result"]["assumptions"]

    def test_are_cached_until_an_input_changes(self, keymint, ws: Path) -> None:
        keymint("prove", cwd=ws)
        outcome = keymint("prove", "--json", cwd=ws)
        cached = [each["unchanged"] for each in outcome.document["result"]["enclaves"]]
        assert cached == [True, True]
        assert self.shared(outcome)["unchanged"] is True
        assert {"omg", "board"} <= {claim["model"] for claim in outcome.document["result"]["enclaves"][0]["claims"]}
        (ws / "install/enclaves/talker" / NOTE).write_text("else")
        outcome = keymint("prove", "--json", cwd=ws)
        assert self.shared(outcome)["unchanged"] is False
        (ws / "install" / BOARD).write_bytes((ws / "install" / BOARD).read_bytes() + b"\n")
        outcome = keymint("prove", "--json", cwd=ws)
        assert [each["unchanged"] for each in outcome.document["result"]["enclaves"]] == [False, False]

    def test_a_board_that_differs_is_refuted(self, keymint, ws: Path) -> None:
        path = ws / "install" / BOARD
        path.write_text(json.dumps({**board(ws), "/stranger": []}))
        outcome = keymint("prove", "talker", "--json", cwd=ws)
        assert outcome.code == 3
        assert self.shared(outcome)["proof"] == "counterexample"
        [said] = [each for each in outcome.document["diagnostics"] if each["code"] == "counterexample"]
        assert said["message"].startswith("/stranger: the document permits it to have a package")
        assert not said["subject"]

    def test_of_an_enclave_cite_the_shared_document(self, keymint, ws: Path) -> None:
        path = ws / "install" / BOARD
        path.write_text(json.dumps({**board(ws), TALKER: []}))
        outcome = keymint("prove", "talker", cwd=ws)
        assert outcome.code == 3
        assert f"install/{BOARD}:1: the board names it [board]" in outcome.err

    def test_without_the_document_nothing_is_claimed(self, keymint, ws: Path) -> None:
        (ws / "install" / BOARD).unlink()
        outcome = keymint("prove", cwd=ws)
        assert outcome.code == 3
        assert f"install/{BOARD}: error: is missing" in outcome.err


def test_one_authority_signs_for_all(keymint, ws: Path) -> None:
    manifest = ws / "src/talker/keymint_package.xml"
    issuer = "<permissions><issuer_name>identity_ca</issuer_name></permissions>"
    manifest.write_text(manifest.read_text().replace(DDS, "").replace("</package>", f"{issuer}</package>"))
    assert keymint("build", cwd=ws).code == 0
    outcome = keymint("install", "--no-prove", cwd=ws)
    assert outcome.code == 1
    assert "/talker has the authority 'identity_ca' in the role 'board'" in outcome.err


def test_a_hidden_package_has_no_rights(keymint, ws: Path) -> None:
    (ws / "src/talker/KEYMINT_IGNORE").touch()
    assert keymint("build", cwd=ws).code == 0
    assert board(ws, "build").keys() == {LISTENER}


def test_two_build_types_that_write_one_file_differently(keymint, ws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.keymint import notice_board

    install = notice_board.NoticeBoard.install

    def other(*arguments: object) -> dict[str, object]:
        files = dict(install(*arguments))
        return {**files, "identity_ca.cert.pem": files[NOTE]}

    monkeypatch.setattr(notice_board.NoticeBoard, "install", other)
    change(ws)
    assert keymint("build", cwd=ws).code == 0
    outcome = keymint("install", "--no-prove", cwd=ws)
    assert outcome.code == 1
    assert f"the build types keymint_ros2_dds and {NAME} both write identity_ca.cert.pem, each its own" in outcome.err


def test_a_profile_for_every_subject_gives_nothing_to_infrastructure(keymint, ws: Path) -> None:
    office = ws / "src/office"
    office.mkdir()
    build_type = f"<export><build_type>{NAME}</build_type></export>"
    (office / "keymint_package.xml").write_text(f"<package><role>infrastructure</role>{build_type}</package>")
    everybody = "<profile name='all'><attachment>/**</attachment><ros_topic qualifier='ALLOW'>"
    everybody += "<attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic></profile></profiles>"
    policy = ws.parent / "policy.xml"
    policy.write_text(policy.read_text().replace("</profiles>", everybody))
    for verb in (("create", "--all"), ("build",), ("install",), ("prove",)):
        outcome = keymint(*verb, cwd=ws)
        assert outcome.code == 0, outcome.err
    assert board(ws)["/office"] == []
    assert all(any("/x" in line for line in board(ws)[subject]) for subject in (TALKER, LISTENER))
