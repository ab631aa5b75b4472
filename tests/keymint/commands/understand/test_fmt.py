# SPDX-License-Identifier: Apache-2.0
"""``keymint fmt``: which files it changes, what it shows, and that nothing is half done."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT, snapshot

UNTIDY = "<profiles><profile name='a'>\n<attachment> /a </attachment> <!-- why --></profile></profiles>"
TIDY = """\
<?xml version="1.0" encoding="UTF-8"?>
<profiles>
  <profile name="a">
    <attachment>/a</attachment> <!-- why -->
  </profile>
</profiles>
"""
TESTS = "<tests><test name='t'><deny object='/a' permission='publish' subject='/b'/></test></tests>"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a policy, a part of it, tests, and files that are no policies."""
    folder = tmp_path / "policy"
    (folder / "parts").mkdir(parents=True)
    (folder / ".git").mkdir()
    (folder / "p.xml").write_text(UNTIDY)
    (folder / "p.test.xml").write_text(TESTS)
    (folder / "parts/one.xml").write_text("<profiles/>")
    (folder / "tidy.xml").write_text(TIDY)
    for name in ("package.xml", "parts/other.xml"):
        (folder / name).write_text("<package  a='b'/>")
    for name in (".hidden.xml", ".git/x.xml", "notes.txt"):
        (folder / name).write_text("<profiles   />")
    (tmp_path / "elsewhere.xml").write_text("<profiles  />")
    (folder / "link.xml").symlink_to("../elsewhere.xml")
    return folder


def test_a_folder_with_all_that_is_below_it(keymint, folder: Path) -> None:
    before = snapshot(folder.parent)
    outcome = keymint("fmt", "policy", "-v")
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines() == [
        "policy/p.test.xml written", "policy/p.xml written", "policy/parts/one.xml written",
        "3 files reformatted, 1 unchanged",
    ]  # fmt: skip
    assert outcome.err.count("left as it is [format-skipped]") == 2
    assert (folder / "p.xml").read_text() == TIDY
    after = snapshot(folder.parent)
    changed = {name for name in after if after[name][2] != before[name][2]}
    assert changed == {"policy/p.xml", "policy/p.test.xml", "policy/parts/one.xml"}
    assert after["policy/tidy.xml"] == before["policy/tidy.xml"]
    again = keymint("fmt", "policy")
    assert (again.code, again.out, again.err) == (0, "no files reformatted, 4 unchanged\n", "")


def test_check_names_each_file_with_its_first_line_that_differs(keymint, folder: Path) -> None:
    (folder / "p.xml").write_text(TIDY.replace("    <att", "\t<att"))
    before = snapshot(folder)
    outcome = keymint("fmt", "--check", "policy")
    assert outcome.code == 3
    assert "policy/p.xml:4: warning: the file is not in canonical form (keymint fmt policy/p.xml)" in outcome.err
    assert outcome.out == "3 files to reformat, 1 unchanged\n"
    assert snapshot(folder) == before
    assert keymint("fmt", "--check", "policy/tidy.xml").code == 0


def test_diff_is_what_patch_applies(keymint, folder: Path, tmp_path: Path) -> None:
    before = snapshot(folder)
    outcome = keymint("fmt", "--diff", "policy")
    assert (outcome.code, outcome.err) == (0, "")
    assert snapshot(folder) == before
    assert keymint("fmt", "--diff", "--check", "policy").code == 3
    subprocess.run(["git", "apply", "--unsafe-paths", "-"], input=outcome.out, text=True, cwd=tmp_path, check=True)
    assert keymint("fmt", "--check", "policy").code == 0


def test_a_dry_run_writes_nothing(keymint, folder: Path) -> None:
    before = snapshot(folder)
    outcome = keymint("fmt", "--dry-run", "policy/p.xml")
    assert outcome.out == "policy/p.xml would be written\n1 file to reformat, 0 unchanged\n"
    assert snapshot(folder) == before


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o755, 0o444])
def test_a_file_keeps_its_mode(keymint, folder: Path, mode: int) -> None:
    (folder / "p.xml").chmod(mode)
    assert keymint("fmt", "policy/p.xml").code == 0
    assert (folder / "p.xml").read_text() == TIDY
    assert (folder / "p.xml").stat().st_mode & 0o777 == mode


def test_a_link_that_is_named_stays_a_link_and_its_file_is_formatted(keymint, folder: Path) -> None:
    assert keymint("fmt", "policy/link.xml").code == 0
    assert (folder / "link.xml").is_symlink()
    assert (folder.parent / "elsewhere.xml").read_text().endswith("?>\n<profiles/>\n")


def test_a_file_that_is_named_twice_is_one_file(keymint, folder: Path) -> None:
    outcome = keymint("fmt", "policy/p.xml", folder / "p.xml", "policy/../policy/p.xml", "policy/parts")
    assert outcome.out.splitlines()[-1] == "2 files reformatted, 0 unchanged"


def test_one_broken_file_and_none_is_changed(keymint, folder: Path) -> None:
    (folder / "broken.xml").write_text("<profiles>\n  <profile>\n</profiles>")
    (folder / "wrong.xml").write_text("<profiles>\n  <profle/>\n</profiles>")
    before = snapshot(folder)
    outcome = keymint("fmt", "policy")
    assert outcome.code == 1
    lines = outcome.err.splitlines()
    assert lines[0].startswith("policy/broken.xml:3: error: not well-formed XML: expected the end of <profile>")
    assert lines[1].startswith("policy/wrong.xml:2: error: <profle> is not expected here")
    assert len(lines) == 2
    assert snapshot(folder) == before


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere.xml", "nowhere.xml: error: no such file (check the path)"),
        ("policy/package.xml", "policy/package.xml: error: is no policy, nor a part or a test of one (name a ComArmor"),
        ("policy/notes.txt/x", "policy/notes.txt/x: error: no such file"),
        ("policy/.git/none", "policy/.git/none: error: no such file"),
        ("empty", "empty: error: no policy was found (name a ComArmor file, or a directory with *.xml files)"),
        ("sros2.xml", "sros2.xml: error: this is an SROS2 policy (keymint import sros2.xml -o comarmor.d)"),
    ],
)
def test_what_it_cannot_format(keymint, folder: Path, name: str, message: str) -> None:
    (folder.parent / "empty").mkdir()
    (folder.parent / "sros2.xml").write_text('<policy version="0.2.0"><enclaves/></policy>')
    outcome = keymint("fmt", name)
    assert outcome.code == 1
    assert outcome.err.startswith(message)
    assert outcome.err.count("\n") == 1


def test_what_is_not_xml(keymint, tmp_path: Path) -> None:
    """A table is a policy, and has no canonical form; a broken document of XML keeps the message of its parser."""
    rows = "subject,kind,permission,object,qualifier\n/a,ros_topic,ros_publish,/x,ALLOW\n"
    (tmp_path / "rules.csv").write_text(rows)
    (tmp_path / "broken.xml").write_bytes(codecs.BOM_UTF8 + b"\n<profiles>")
    (tmp_path / "wide.xml").write_bytes(UNTIDY.encode("utf-16"))
    with contextlib.closing(sqlite3.connect(tmp_path / "fleet.sqlite")) as fleet:
        fleet.execute("CREATE VIEW rule AS SELECT 1")
    for name, content in (("notes.txt", b"subject"), ("empty.xml", b""), ("image", b"\x89PNG")):
        (tmp_path / name).write_bytes(content)
    table = "is a table of rules, and 'keymint fmt' is for policies in XML (leave it out: 'keymint lint' checks it)"
    other = "is not XML, and 'keymint fmt' is for policies in XML (name a ComArmor file, or leave it out)"
    found = {"rules.csv": table, "fleet.sqlite": table, "notes.txt": other, "empty.xml": other, "image": other}
    outcome = keymint("fmt", *found, "broken.xml", "wide.xml")
    assert outcome.code == 1
    assert outcome.err.splitlines()[:-1] == [
        f"{name}: error: {message} [format-unknown]" for name, message in found.items()
    ]
    assert "broken.xml:2: error: not well-formed XML" in outcome.err.splitlines()[-1]


def test_the_policies_of_a_workspace(keymint, provisioned: Path, tmp_path: Path) -> None:
    assert keymint("init", "other").code == 0
    policy = tmp_path / "other/profile/comarmor.d/talker_listener.xml"
    policy.write_text(policy.read_text().replace("\n", "\n\n\n").replace("<profiles", "\n\n<profiles"))
    for words in (("-w", "other"), ("other",), ("other/profile",)):
        outcome = keymint("fmt", "--check", *words)
        assert outcome.code == 3
        assert outcome.err.startswith("other/profile/comarmor.d/talker_listener.xml:2: warning")
        assert outcome.err.count("\n") == 1
    assert keymint("fmt", "-w", "other").code == 0
    assert keymint("fmt", "--check", "other").out.startswith("no files to reformat, ")
    assert keymint("fmt", "--check", "ws").out == "1 file to reformat, 0 unchanged\n"  # the policy is elsewhere


def stdin(text: str) -> io.TextIOWrapper:
    return io.TextIOWrapper(io.BytesIO(text.encode()), "utf-8")


def test_standard_input_is_written_to_standard_output(keymint, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", stdin(UNTIDY))
    outcome = keymint("fmt", "-")
    assert (outcome.code, outcome.out, outcome.err) == (0, TIDY, "")
    monkeypatch.setattr(sys, "stdin", stdin(UNTIDY))
    outcome = keymint("fmt", "--check", "-")
    assert (outcome.code, outcome.out) == (3, "1 file to reformat, 0 unchanged\n")
    assert outcome.err == "-:1: warning: the file is not in canonical form (keymint fmt -) [format]\n"
    monkeypatch.setattr(sys, "stdin", stdin("<profiles>"))
    outcome = keymint("fmt", "-")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("-:1: error: not well-formed XML")
    monkeypatch.setattr(sys, "stdin", stdin(UNTIDY))
    assert keymint("fmt", "-", "--json").document["result"]["text"] == TIDY
    monkeypatch.setattr(sys, "stdin", None)
    assert keymint("fmt", "-").code == 1


def test_standard_input_stands_alone(keymint, folder: Path) -> None:
    outcome = keymint("fmt", "-", "policy")
    assert outcome.code == 2
    assert "stands alone" in outcome.err


def test_json(keymint, folder: Path) -> None:
    document = keymint("fmt", "--diff", "--check", "policy/p.xml", "policy/tidy.xml", "--json").document
    assert document["result"]["files"] == [
        {"file": "policy/p.xml", "changed": True}, {"file": "policy/tidy.xml", "changed": False},
    ]  # fmt: skip
    assert document["result"]["diff"].startswith("--- a/policy/p.xml\n+++ b/policy/p.xml\n@@ -1,2 +1,6 @@\n")
    assert document["result"]["written"] == []
    assert [(each["code"], each["file"], each["line"]) for each in document["diagnostics"]] == [
        ("format", "policy/p.xml", 1)
    ]
    assert keymint("fmt", "policy/p.xml", "--json").document["result"]["written"] == ["policy/p.xml"]


def test_a_file_that_changes_meanwhile_is_not_overwritten(
    keymint, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from keymint.commands.understand import fmt

    real = fmt.replace_inputs

    def late(run, changed) -> None:
        (folder / "p.xml").write_text("<profiles><!-- saved by an editor --></profiles>")
        real(run, changed)

    monkeypatch.setattr(fmt, "replace_inputs", late)
    outcome = keymint("fmt", "policy", env={"KEYMINT_ADVICE": "0"})
    assert outcome.code == 1
    assert (
        outcome.err
        == "policy/p.xml: error: changed meanwhile (nothing was written; run the command again) [file-changed]\n"
    )
    assert "saved by an editor" in (folder / "p.xml").read_text()
    assert (folder / "p.test.xml").read_text() == TESTS


def test_a_folder_that_cannot_be_written_leaves_all_files_as_they_are(keymint, folder: Path) -> None:
    if os.geteuid() == 0:
        (folder / "parts/one.xml").unlink()
        (folder / "parts/one.xml").mkdir()
        assert keymint("fmt", "policy").code == 0  # a folder of this name is no file
        return
    (folder / "parts").chmod(0o500)
    before = snapshot(folder)
    assert keymint("fmt", "policy").code == 1
    assert snapshot(folder) == before


def test_what_other_verbs_write_has_the_form(keymint, tmp_path: Path) -> None:
    assert keymint("init", "ws").code == 0
    assert keymint("learn", CHECKOUT / "examples/ppac_2018/graph.json", "-o", "learned/p.xml").code == 0
    (tmp_path / "sros2.xml").write_text(
        '<policy version="0.2.0"><enclaves><!-- two\n\t\tlines --><enclave path="/a">'
        '<profiles><profile ns="/" node="a"><topics publish="ALLOW" subscribe="ALLOW"><topic>b</topic></topics>'
        "</profile></profiles></enclave></enclaves></policy>"
    )
    assert keymint("import", "sros2.xml", "-o", "imported").code == 0
    for name in ("ws", "learned", "imported"):
        outcome = keymint("fmt", "--check", "--diff", name)
        assert (outcome.code, outcome.err) == (0, ""), outcome.out
