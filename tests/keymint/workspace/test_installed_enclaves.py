# SPDX-License-Identifier: Apache-2.0
"""No false green: what is hidden, not created or cannot be read is a finding, and never stops or removes the rest."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.view.tree import MAX_FILE
from tests.conftest import snapshot


def sources(ws: Path) -> None:
    shutil.rmtree(ws / "src")
    (ws / "src").mkdir()


class TestNoPackage:
    @pytest.mark.parametrize("verb", ["check", "prove", "install"])
    @pytest.mark.parametrize("how", ["none created", "all hidden", "all removed"])
    def test_is_a_finding_where_the_policy_names_subjects(self, keymint, policy: Path, ws: Path, verb, how) -> None:
        if how == "none created":
            shutil.rmtree(ws)
            assert keymint("init", "ws", "--policy", policy).code == 0
        elif how == "all hidden":
            (ws / "src/KEYMINT_IGNORE").touch()
        else:
            sources(ws)
        outcome = keymint(verb, "--json", cwd=ws)
        assert outcome.code == 3, outcome.out
        (found,) = [each for each in outcome.document["diagnostics"] if each["code"] == "subjects-uncreated"]
        assert "2 subjects" in found["message"]
        assert "/robot1/listener, /talker" in found["message"]
        if how == "all hidden":
            assert found["file"] == "src/KEYMINT_IGNORE"
            (ws / "src/KEYMINT_IGNORE").unlink()
        else:
            assert "'keymint create --all'" in found["help"]
            for words in (("create", "--all"), ("build",), ("install",)):
                assert keymint(*words, cwd=ws).code == 0
        assert keymint("check", cwd=ws).code == 0

    @pytest.mark.parametrize("verb", ["check", "status", "build", "install", "prove"])
    def test_an_illegal_name_is_reported_with_its_folder(self, keymint, ws: Path, verb: str) -> None:
        shutil.copytree(ws / "src/talker", ws / "src/two words")
        outcome = keymint(verb, cwd=ws)
        assert outcome.code == 1
        assert outcome.err.startswith("src/two words: error: 'two words' is not a legal name")

    @pytest.mark.parametrize("verb", ["check", "prove"])
    def test_one_that_is_missing_is_noted(self, keymint, ws: Path, verb: str) -> None:
        policy = ws.parent / "policy.xml"
        policy.write_text(
            policy.read_text().replace(
                "</profiles>", "<profile name='n'><attachment>/new</attachment></profile></profiles>"
            )
        )
        outcome = keymint(verb, "--json", cwd=ws)
        assert outcome.code == 0
        assert "subjects-uncreated" in outcome.codes()
        assert "subjects-uncreated" not in keymint(verb, "talker", "--json", cwd=ws).codes()

    @pytest.mark.parametrize("verb", ["build", "install", "check", "prove"])
    def test_others_than_the_created_ones_are_told(self, keymint, policy: Path, verb: str) -> None:
        assert keymint("init", "some", "--policy", policy).code == 0
        for words in (("create", "talker"), ("build",), ("install",)):
            assert keymint(*words, "-w", "some").code == 0
        outcome = keymint(verb, "-w", "some")
        assert outcome.code == 0
        assert "the policy names a subject that has no source package: /robot1/listener" in outcome.err

    @pytest.mark.parametrize("verb", ["check", "prove", "install"])
    def test_of_a_policy_that_names_nobody_is_none(self, keymint, tmp_path: Path, verb: str) -> None:
        (tmp_path / "p.xml").write_text("<profiles><profile name='a'><attachment>/x*</attachment></profile></profiles>")
        assert keymint("init", "empty", "--policy", "p.xml").code == 0
        assert keymint(verb, "-w", "empty").code == 0


class TestMarkers:
    @pytest.mark.parametrize("place", ["src", "src/robot1", "src/robot1/listener"])
    def test_prune_removes_nothing_that_is_hidden(self, keymint, ws: Path, place: str) -> None:
        (ws / place / "KEYMINT_IGNORE").touch()
        before = snapshot(ws / "install")
        outcome = keymint("install", "--prune", "--no-prove", "--json", cwd=ws)
        assert snapshot(ws / "install") == before
        assert "enclave-ignored" in outcome.codes()
        checked = keymint("check", "--json", cwd=ws)
        assert (checked.code, "enclave-ignored" in checked.codes()) == (3, True)
        rows = {row["package"]: row for row in keymint("status", "--json", cwd=ws).document["result"]["packages"]}
        assert (rows["robot1/listener"]["stage"], rows["robot1/listener"]["stale"]) == ("ignored", None)

    @pytest.mark.parametrize("kind", [Path.mkdir, lambda path: path.symlink_to("/etc/hostname"), os.mkfifo])
    def test_only_a_regular_file_is_one(self, keymint, ws: Path, kind: Callable[[Path], None]) -> None:
        kind(ws / "src/KEYMINT_IGNORE")
        assert keymint("build", cwd=ws).out.startswith("nothing to do: 2 packages")
        assert keymint("check", cwd=ws).code == 0

    def test_prune_without_a_source_space_is_refused(self, keymint, ws: Path) -> None:
        before = snapshot(ws)
        outcome = keymint("install", "--prune", "--no-prove", "--src-space", "scr", cwd=ws)
        assert outcome.code == 1
        assert "scr: error: there is no source space" in outcome.err
        assert snapshot(ws) == before

    @pytest.mark.parametrize(
        "name", ["KEYMINT_IGNORE", "robot/KEYMINT_IGNORE/arm", "keymint_ignore", ".keymint", "a/key.pem"]
    )
    def test_subjects_that_would_be_one_are_refused_at_their_place(self, keymint, tmp_path: Path, name: str) -> None:
        (tmp_path / "p.xml").write_text(
            f"<profiles>\n<profile name='a'>\n<attachment>/{name}</attachment></profile></profiles>"
        )
        outcome = keymint("provision", "p.xml", "-w", "new")
        assert outcome.code == 1
        assert outcome.err.startswith("p.xml:")
        assert name in outcome.err
        assert not (tmp_path / "new").exists()

    @pytest.mark.parametrize("name", ["public", "private", "enclaves", "Public/x"])
    def test_in_the_flat_layout_folders_of_the_other_are_reserved(self, keymint, tmp_path: Path, name: str) -> None:
        (tmp_path / "p.xml").write_text(
            f"<profiles><profile name='a'><attachment>/{name}</attachment></profile></profiles>"
        )
        outcome = keymint("provision", "p.xml", "-w", "flat", "--layout", "flat")
        assert outcome.code == 1
        assert "is not allowed in the layout of this workspace" in outcome.err
        assert keymint("provision", "p.xml", "-w", "sros2").code == 0
        assert keymint("check", "-w", "sros2").code == 0


def large(path: Path) -> None:
    path.unlink(missing_ok=True)
    with path.open("wb") as file:
        file.truncate(MAX_FILE + 1)


def pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def link(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to("/etc/hostname")


class TestOneBadEnclave:
    """A file that cannot be read is one enclave's trouble."""

    @pytest.mark.parametrize("bad", [large, pipe, link])
    @pytest.mark.parametrize("name", ["cert.pem", "key.pem", "permissions.p7s", "stray.bin"])
    def test_stops_nothing_of_the_others(self, keymint, ws: Path, bad: Callable[[Path], None], name: str) -> None:
        bad(ws / "install/enclaves/talker" / name)
        outcome = keymint("check", "--json", cwd=ws)
        assert outcome.code == 3
        said = [
            each for each in outcome.document["diagnostics"] if each["file"] and each["file"].endswith(f"talker/{name}")
        ]
        assert said
        assert {each["subject"] for each in outcome.document["diagnostics"]} <= {"/talker", ""}
        rows = keymint("status", "--json", cwd=ws).document["result"]["packages"]
        assert {row["package"]: row["stale"] for row in rows}["robot1/listener"] is None
        proven = keymint("prove", "--json", cwd=ws).document["result"]["enclaves"]
        assert {each["subject"]: each["proof"] for each in proven}["/robot1/listener"] == "proven"

        other = ws / "install/enclaves/robot1/listener/permissions.p7s"
        good = other.read_bytes()
        other.write_bytes(good[:-9])
        outcome = keymint("install", cwd=ws)
        assert other.read_bytes() != good[:-9]
        blocked = bad is not large and name != "stray.bin"
        assert outcome.code == int(blocked), outcome.err
        if blocked:
            assert f"install/enclaves/talker/{name}: error: is" in outcome.err
            (ws / "install/enclaves/talker" / name).unlink()
            assert keymint("install", cwd=ws).code == 0
        if name == "stray.bin":
            (ws / "install/enclaves/talker" / name).unlink()
        assert keymint("check", cwd=ws).code == 0

    @pytest.mark.parametrize("name", ["build/talker/permissions.xml", "src/talker/permissions.xml"])
    def test_nor_do_its_sources(self, keymint, ws: Path, name: str) -> None:
        large(ws / name)
        rows = keymint("status", "--json", cwd=ws).document["result"]["packages"]
        assert {row["package"]: row["problem"] for row in rows}["robot1/listener"] is None
        assert {row["package"]: row["problem"] for row in rows}["talker"]
        if name.startswith("src"):
            outcome = keymint("check", "--json", cwd=ws)
            assert outcome.code == 3
            assert outcome.document["result"]["checked"] == ["/robot1/listener", "/talker"]


class TestPrune:
    def remove(self, ws: Path) -> None:
        for path in (ws / "src/talker").iterdir():
            path.unlink()
        (ws / "src/talker").rmdir()

    def test_an_enclave_without_a_package_is_reported(self, keymint, provisioned: Path) -> None:
        self.remove(provisioned)
        assert "orphaned" in keymint("status", cwd=provisioned).out
        outcome = keymint("install", cwd=provisioned)
        assert "the enclave /talker is installed, but has no source package" in outcome.err
        assert (provisioned / "install/enclaves/talker/key.pem").is_file()

    def test_and_removed_on_request(self, keymint, provisioned: Path) -> None:
        self.remove(provisioned)
        assert keymint("install", "--prune", cwd=provisioned).code == 0
        assert not (provisioned / "install/enclaves/talker").exists()
        assert (provisioned / "install/enclaves/robot1/listener/key.pem").is_file()
        assert keymint("check", cwd=provisioned).code == 0

    def test_enclaves_inside_of_it_stay(self, keymint, tmp_path: Path) -> None:
        (tmp_path / "p.xml").write_text(
            "<profiles><profile name='a'><attachments><attachment>/robot</attachment>"
            "<attachment>/robot/arm</attachment></attachments></profile></profiles>"
        )
        assert keymint("provision", "p.xml", "-w", "ws").code == 0
        ws = tmp_path / "ws"
        for path in (ws / "src/robot").glob("*.xml"):
            path.unlink()
        assert keymint("install", "--prune", cwd=ws).code == 0
        assert not (ws / "install/enclaves/robot/key.pem").exists()
        assert (ws / "install/enclaves/robot/arm/key.pem").is_file()
