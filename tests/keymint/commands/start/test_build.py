# SPDX-License-Identifier: Apache-2.0
"""``keymint build``."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.conftest import snapshot


@pytest.fixture
def ws(keymint, policy: Path, tmp_path: Path) -> Path:
    assert keymint("init", "ws", "--policy", policy).code == 0
    assert keymint("create", "--all", "-w", "ws").code == 0
    return tmp_path / "ws"


def test_unsigned_documents_and_a_key(keymint, ws: Path) -> None:
    assert keymint("build", cwd=ws).code == 0
    assert "<topic>rt/chatter</topic>" in (ws / "build/talker/permissions.xml").read_text()
    assert (ws / "build/robot1/listener/governance.xml").is_file()
    key = ws / "private/identities/robot1/listener/key.pem"
    assert key.stat().st_mode & 0o777 == 0o600
    assert key.parent.stat().st_mode & 0o777 == 0o700
    assert not (ws / "install").exists()


def test_one_package_by_name(keymint, ws: Path) -> None:
    assert keymint("build", "/robot1/listener", cwd=ws).code == 0
    assert not (ws / "build/talker").exists()


def test_an_unknown_package(keymint, ws: Path) -> None:
    outcome = keymint("build", "robot1/listner", cwd=ws)
    assert outcome.code == 1
    assert "did you mean 'robot1/listener'?" in outcome.err


def test_documents_are_the_same_whatever_the_machine(keymint, policy: Path, tmp_path: Path) -> None:
    documents = []
    for name in ("one", "two"):
        assert keymint("provision", policy, "-w", name).code == 0
        documents.append({path: content for path, (_, _, content) in snapshot(tmp_path / name / "build").items()})
    assert documents[0] == documents[1]


PORTABILITY = """<profiles><profile name="p"><attachment>/cam</attachment>
  <topic qualifier="ALLOW"><attachment>image*</attachment><permissions><publish/></permissions>
    <partitions><partition>*</partition></partitions></topic>
  <topic qualifier="DENY"><attachment>image_raw</attachment><permissions><publish/></permissions>
    <partitions><partition>left</partition></partitions></topic>
</profile></profiles>
"""


def test_what_vendors_decide_differently_is_an_error_at_the_policys_line(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(PORTABILITY)
    outcome = keymint("provision", "p.xml", "-w", "ws2")
    assert outcome.code == 1
    assert "p.xml:4: error:" in outcome.err
    assert not (tmp_path / "ws2").exists()


def test_and_a_warning_where_the_user_chooses(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(PORTABILITY)
    outcome = keymint("provision", "p.xml", "-w", "ws2", "--allow-vendor-specific")
    assert outcome.code == 0
    assert "p.xml:4: warning:" in outcome.err


def test_a_workspace_without_packages(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    outcome = keymint("build", cwd=tmp_path / "ws")
    assert outcome.code == 0
    assert "no packages in src (run 'keymint create --all')" in outcome.err


def test_ignored_folders_are_not_searched(keymint, ws: Path) -> None:
    (ws / "src/robot1/KEYMINT_IGNORE").touch()
    assert keymint("build", cwd=ws).code == 0
    assert not (ws / "build/robot1").exists()


class TestForms:
    def test_the_gain_is_told_for_each_package_and_in_all(self, keymint, ws: Path) -> None:
        outcome = keymint("build", "--json", cwd=ws)
        sizes = {step["package"]: step["sizes"] for step in outcome.document["steps"]}
        for package, (size,) in sizes.items():
            assert size["file"] == "permissions.xml"
            written = (ws / "build" / package / "permissions.xml").read_bytes()
            assert size["bytes"] == len(written) <= size["plain_bytes"]
        total, plain = (sum(size[key] for (size,) in sizes.values()) for key in ("bytes", "plain_bytes"))
        assert total < plain
        assert all(size["bytes"] < size["plain_bytes"] for (size,) in sizes.values())
        assert keymint("build", "--no-optimise", cwd=ws).out.splitlines()[-1].startswith("2 updated")
        told = keymint("build", cwd=ws).out.splitlines()[-1]
        assert told.startswith(f"permissions.xml of 2 packages: {total:,} bytes, {plain:,} in plain form (-")

    def test_the_plain_form_stays_until_another_is_asked_for(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        document = ws / "build/talker/permissions.xml"
        small = document.read_bytes()
        assert keymint("build", "--no-optimise", cwd=ws).code == 0
        plain = document.read_bytes()
        assert keymint("build", "--no-optimise", cwd=ws).out.startswith("nothing to do")
        assert document.read_bytes() == plain
        assert len(plain) > len(small)
        keymint("install", cwd=ws)
        assert keymint("status", cwd=ws).code == 0
        checked = keymint("check", cwd=ws)
        assert (checked.code, checked.err) == (0, ""), "another form of the same is no drift"
        assert keymint("build", cwd=ws).code == 0
        assert document.read_bytes() == small

    def test_hints_put_first_what_is_asked_for_most(self, keymint, ws: Path) -> None:
        hints = ws / "hints.csv"
        hints.write_text("subject,permission,object,count\n/talker,ros_publish,/rosout,9\n")
        document = ws / "build/talker/permissions.xml"
        keymint("build", cwd=ws)
        assert document.read_text().index("rt/rosout<") > document.read_text().index("rt/chatter")
        listener = (ws / "build/robot1/listener/permissions.xml").read_bytes()
        outcome = keymint("build", "--hints", "hints.csv", "--json", cwd=ws)
        assert (outcome.code, outcome.err) == (0, "")
        assert {step["package"]: step["action"] for step in outcome.document["steps"]} == {
            "talker": "updated",
            "robot1/listener": "unchanged",
        }
        text = document.read_text()
        assert text.index("rt/rosout<") < text.index("rt/chatter")
        assert (ws / "build/robot1/listener/permissions.xml").read_bytes() == listener
        assert keymint("build", "--hints", "hints.csv", cwd=ws).out.startswith("nothing to do")
        assert keymint("install", cwd=ws).code == 0

    def test_hints_for_unknown_subjects_are_reported(self, keymint, ws: Path) -> None:
        (ws / "hints.csv").write_text("subject,permission,object,count\n/talkr,ros_publish,/a,9\n")
        outcome = keymint("build", "--hints", "hints.csv", cwd=ws)
        assert outcome.code == 0
        assert outcome.err == (
            "hints.csv: warning: the hints name /talkr, which is not a subject of this workspace "
            "(did you mean '/talker'?) [hints-subject]\n"
        )

    @pytest.mark.parametrize(
        ("words", "code", "said"),
        [
            (["--hints", "none.csv"], 1, "none.csv: error: no such file"),
            (["--hints", "bad.csv"], 1, "bad.csv:1: error: the first line is 'a,b', not the names of the columns"),
            (["--hints", "bad.csv", "--no-optimise"], 2, "--hints changes the order of rules"),
        ],
    )
    def test_wrong_hints_build_nothing(self, keymint, ws: Path, words, code, said) -> None:
        (ws / "bad.csv").write_text("a,b\n")
        before = snapshot(ws)
        outcome = keymint("build", *words, cwd=ws)
        assert outcome.code == code
        assert said in outcome.err
        assert snapshot(ws) == before


@pytest.mark.parametrize(
    ("file", "pattern", "by"),
    [
        ("permissions", "<not_after>.*?<", "<not_after>garbage<"),
        ("permissions", "<id>0<", "<id>300<"),
        ("permissions", "<subject_name>.*</subject_name>", ""),
        ("permissions", "{common_name}", "{comon}"),
        ("permissions", "permissions_ca", "prmissions_ca"),
        ("permissions", "</defaults>", ""),
        ("governance", "<id>0<", "<id>300<"),
        ("governance", "ENCRYPT<", "ENCRIPT<"),
        ("identities", "<not_after>.*?<", "<not_after>2020-01-01T00:00:00<"),
        ("identities", "<subject_name>.*</subject_name>", ""),
        ("identities", "SECP256R1", "SECT233K1"),
        ("identities", "SHA256", "SHA1"),
    ],
)
@pytest.mark.parametrize("verb", ["build", "check"])
def test_a_defect_in_the_defaults_is_one_line_for_all_packages(
    keymint, tmp_path: Path, verb: str, file: str, pattern: str, by: str
) -> None:
    (tmp_path / "p.xml").write_text(
        "<profiles>"
        + "".join(f"<profile name='n{n}'><attachment>/n{n}</attachment></profile>" for n in range(3))
        + "</profiles>"
    )
    keymint("provision", "p.xml", "-w", "ws")
    defaults = tmp_path / f"ws/profile/package.defaults/{file}.xml"
    defaults.write_text(re.sub(pattern, by, defaults.read_text()))
    outcome = keymint(verb, "-w", "ws")
    lines = [line for line in outcome.err.splitlines() if "package.defaults" in line]
    assert lines
    assert len(lines) == len(set(lines))
    assert all("[3 packages]" in line for line in lines)
    assert not [line for line in outcome.err.splitlines() if "ws/src/" in line]


# -- new keys ---------------------------------------------------------------------------------------------------------


def _key(ws: Path, name: str) -> bytes:
    return (ws / f"private/identities/{name}/key.pem").read_bytes()


def test_new_keys_are_for_named_packages_and_said(keymint, ws: Path) -> None:
    assert keymint("build", cwd=ws).code == 0
    before = [_key(ws, name) for name in ("talker", "robot1/listener")]
    assert keymint("build", "--rekey", "--json", cwd=ws).code == 2
    made = keymint("build", "--rekey", "talker", cwd=ws)
    assert "1 private key replaced: /talker" in made.err
    after = [_key(ws, name) for name in ("talker", "robot1/listener")]
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, True]


@pytest.mark.parametrize("words", [("build", "--renew"), ("provision", "../policy.xml", "--renew")])
def test_the_former_word_names_both(keymint, ws: Path, words: tuple[str, ...]) -> None:
    refused = keymint(*words, cwd=ws)
    assert refused.code == 2
    assert "--rekey" in refused.err
    assert "'keymint renew'" in refused.err
    assert "--renew" not in keymint(words[0], "--help").out


def test_provision_replaces_the_keys_that_are_named(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws").code == 0
    before = [_key(tmp_path / "ws", name) for name in ("talker", "robot1/listener")]
    made = keymint("provision", policy, "-w", "ws", "--rekey", "/talker")
    assert (made.code, "1 private key replaced: /talker" in made.err) == (0, True)
    after = [_key(tmp_path / "ws", name) for name in ("talker", "robot1/listener")]
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, True]
    assert keymint("check", "-w", "ws").code == 0
    assert keymint("provision", policy, "-w", "ws", "--rekey", "/nobody").code == 1


def test_defaults_that_were_deleted_are_to_be_restored(keymint, created: Path) -> None:
    shutil.rmtree(created / "profile/package.defaults")
    refused = keymint("build", cwd=created)
    assert refused.code == 1
    assert "no file 'package.defaults/identities.xml' in the package or its profile (restore it" in refused.err
    assert "did you mean" not in refused.err
