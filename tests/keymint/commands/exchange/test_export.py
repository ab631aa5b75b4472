# SPDX-License-Identifier: Apache-2.0
"""``keymint export``: what is written, and what stands in the way."""

from __future__ import annotations

from pathlib import Path

import pytest

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="talker"><attachment>/talker</attachment><attachment>/robots/*</attachment>
    <xi:include href="common/node/graph.xml"/>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
</profiles>
"""
RELAY = '<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_relay/></permissions></ros_topic>'


@pytest.fixture(autouse=True)
def source(tmp_path: Path) -> Path:
    path = tmp_path / "source.xml"
    path.write_text(POLICY)
    return path


def test_to_standard_output_and_back(keymint, tmp_path: Path) -> None:
    outcome = keymint("export", "source.xml", "--format", "sros2")
    assert (outcome.code, outcome.err) == (0, "")
    (tmp_path / "policy.xml").write_text(outcome.out)
    assert keymint("import", "policy.xml", "-o", "new").code == 0
    assert keymint("diff", "policy.xml", "new").out.startswith("equivalent")
    lost = keymint("diff", "source.xml", "new").out  # what the other language cannot say: patterns of subjects
    assert "/talker" not in lost
    assert "/robots/*" in lost


def test_to_a_file(keymint, tmp_path: Path) -> None:
    words = ("export", "source.xml", "--format", "sros2", "-o", "policy.xml")
    assert keymint(*words, "--dry-run").out == "policy.xml would be written\n"
    assert not (tmp_path / "policy.xml").exists()
    assert keymint(*words).out == "policy.xml written\n"
    assert keymint(*words).out == "policy.xml is up to date\n"
    (tmp_path / "policy.xml").write_text("mine")
    assert keymint(*words, "--json").codes() == ["export-exists"]
    assert (tmp_path / "policy.xml").read_text() == "mine"
    assert keymint(*words, "-f").code == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [(b"/b\xff", "is not UTF-8"), (b"/b\x01", "'/b\\x01'"), ("/b\u2028/c".encode(), "'/b\\u2028/c'")],
    ids=["bytes", "control", "line separator"],
)
@pytest.mark.parametrize("form", ["sros2", "xacml"])
def test_a_list_of_subjects_that_cannot_be_read(keymint, tmp_path: Path, form: str, line: bytes, message: str) -> None:
    (tmp_path / "names").write_bytes(b"\xef\xbb\xbf/robots/a\r\n\r\n" + line + b"\r\n")
    outcome = keymint("export", "source.xml", "--format", form, "--subjects", "names")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("names:3: error: the ")
    assert message in outcome.err


def test_a_file_whose_name_xml_cannot_contain(keymint, source: Path) -> None:
    source.rename(source.with_name("a\x01b.xml"))
    outcome = keymint("export", "a\x01b.xml", "--format", "xacml")
    assert outcome.code == 0
    assert "<Description>a\\x01b.xml:4</Description>" in outcome.out


def test_further_subjects(keymint, tmp_path: Path) -> None:
    (tmp_path / "names").write_text("# robots\n/robots/one  # the first\n\n/talker\n")
    words = ("export", "source.xml", "--format", "sros2", "--subjects", "names", "--json")
    assert keymint(*words).document["result"]["subjects"] == ["/talker", "/robots/one"]
    (tmp_path / "names").write_text("/talker\n/other\n")
    found = keymint(*words).document["diagnostics"][0]
    assert (found["code"], found["file"], found["line"]) == ("subject-unknown", "names", 2)


def test_a_policy_that_names_nobody(keymint, source: Path) -> None:
    source.write_text(POLICY.replace("<attachment>/talker</attachment>", ""))
    assert keymint("export", "source.xml", "--format", "sros2", "--json").codes() == ["subjects-none"]


def test_what_cannot_be_said(keymint, source: Path, tmp_path: Path) -> None:
    source.write_text(POLICY.replace("</profile>", f"{RELAY}</profile>"))
    words = ("export", "source.xml", "--format", "sros2", "-o", "policy.xml", "--json")
    refused = keymint(*words)
    assert (refused.code, refused.codes()) == (1, ["sros2-unsayable"])
    assert refused.document["diagnostics"][0]["line"] == 5
    assert not (tmp_path / "policy.xml").exists()
    lossy = keymint(*words, "--lossy")
    assert (lossy.code, lossy.codes()) == (0, ["sros2-unsayable"])
    assert lossy.document["diagnostics"][0]["severity"] == "warning"


def test_an_unknown_format(keymint) -> None:
    outcome = keymint("export", "source.xml", "--format", "sros")
    assert outcome.code == 2
    assert "did you mean 'sros2'?" in outcome.err


def test_a_document_that_is_not_proven_is_not_written(keymint, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from keymint_ros2_sros2 import export

    right = export.permissions_document
    monkeypatch.setattr(
        export, "permissions_document", lambda *a, **o: right(*a, **o).replace(b"rt/chatter<", b"rt/other<")
    )
    outcome = keymint("export", "source.xml", "--format", "sros2", "-o", "policy.xml", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["import-unproven"])
    assert not (tmp_path / "policy.xml").exists()


def test_of_a_workspace(keymint, source: Path) -> None:
    assert keymint("provision", "source.xml", "-w", "ws").code == 0
    outcome = keymint("export", "-w", "ws", "--format", "sros2", "--json")
    assert outcome.document["result"]["subjects"] == ["/talker"]


def test_xacml(keymint, source: Path, tmp_path: Path) -> None:
    words = ("export", "source.xml", "--format", "xacml", "-o", "policy.xacml.xml")
    assert keymint(*words).out == "policy.xacml.xml written\n"
    assert keymint(*words).out == "policy.xacml.xml is up to date\n"
    first = (tmp_path / "policy.xacml.xml").read_text()
    assert str(tmp_path) not in first
    assert "<Description>source.xml:4</Description>" in first
    source.write_text(POLICY.replace("/chatter", "/chat*"))
    outcome = keymint("export", "source.xml", "--format", "xacml", "--json")
    assert outcome.document["result"]["subjects"] == ["/talker"]
    assert outcome.document["result"]["policy"] == first.replace(">/chatter<", r">^/chat[\s\S]*$<").replace(
        'function:string-equal">\n                <AttributeValue DataType="http://www.w3.org/2001/XMLSchema#string">^',
        'function:string-regexp-match">\n                <AttributeValue DataType="http://www.w3.org/2001/XMLSchema#string">^',
    )
