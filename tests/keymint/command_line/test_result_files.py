# SPDX-License-Identifier: Apache-2.0
"""A file of results never tells of an earlier run: an error is a result in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest


@pytest.mark.parametrize("verb", ["lint", "check"])
def test_an_error_replaces_the_findings_of_before(keymint: Callable, provisioned: Path, verb: str) -> None:
    words = (verb, "--sarif", provisioned.parent / "found.sarif", "-w", provisioned)
    assert keymint(*words).code in {0, 3}
    (provisioned / "profile/keymint_profile.xml").write_text("<profile\n>no</")
    failed = keymint(*words, "--json")
    assert failed.code == 1
    (result,) = json.loads((provisioned.parent / "found.sarif").read_text())["runs"][0]["results"]
    assert (result["ruleId"], result["level"]) == (failed.codes()[0], "error")
    place = result["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"].endswith("profile/keymint_profile.xml")
    assert place["region"]["startLine"] >= 1


def test_an_error_replaces_the_test_results_of_before(keymint: Callable, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text("<profiles><profile name='a'><attachment>/a</attachment></profile></profiles>")
    tests = tmp_path / "p.test.xml"
    tests.write_text('<tests><test name="t"><deny subject="/a" permission="ros_publish" object="/x"/></test></tests>')
    words = ("test", "p.xml", "--junit", "tests.xml")
    assert keymint(*words).code == 0
    tests.write_text("<tests><nothing/></tests>")
    failed = keymint(*words)
    assert failed.code == 1
    suite = ET.fromstring((tmp_path / "tests.xml").read_text())[0]
    assert (suite.attrib["tests"], suite.attrib["failures"]) == ("1", "1")
    assert "p.test.xml:1" in suite[0].attrib["classname"]


def test_what_cannot_be_written_is_said_beside_the_error(keymint: Callable, tmp_path: Path) -> None:
    (tmp_path / "taken").touch()
    outcome = keymint("lint", "nothing.xml", "--sarif", "taken/found.sarif", "--json")
    assert outcome.codes() == ["policy-missing", "write-failed"]


_TESTS = '<tests><test name="t"><deny subject="/a" permission="ros_publish" object="/x"/></test></tests>'
_POLICY = "<profiles><profile name='a'><attachment>/a</attachment></profile></profiles>"


def test_an_output_replaces_no_policy_test_or_page(keymint: Callable, tmp_path: Path) -> None:
    files = {
        "policy.xml": _POLICY,
        "policy.test.xml": _TESTS,
        "index.html": "<!DOCTYPE html>\n<html lang='en'>\n<head>\n<title>mine</title>",
    }
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    for words in (
        ("lint", "policy.xml", "--sarif", "policy.xml"),
        ("test", "policy.xml", "--junit", "policy.test.xml"),
        ("graph", "policy.xml", "-o", "index.html"),
    ):
        refused = keymint(*words, "--json")
        assert refused.codes().count("output-foreign") == 1, refused.document
        assert refused.code == 2
        assert refused.document["diagnostics"][-1]["file"] == words[-1]
    assert {name: (tmp_path / name).read_text() for name in files} == files


def test_an_error_is_not_written_over_a_policy(keymint: Callable, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(_POLICY)
    assert keymint("lint", "nothing.xml", "--sarif", "policy.xml", "--json").codes() == [
        "policy-missing",
        "output-foreign",
    ]
    assert (tmp_path / "policy.xml").read_text() == _POLICY


@pytest.mark.parametrize("name", ["private/identity_ca.key.pem", "profile/keymint_profile.xml"])
@pytest.mark.parametrize(
    "verb", [("check", "--sarif"), ("graph", "--format", "svg", "-o"), ("authority", "export", "identity_ca", "-o")]
)
def test_an_output_replaces_no_file_of_a_workspace(
    keymint: Callable, provisioned: Path, name: str, verb: tuple[str, ...]
) -> None:
    before = (provisioned / name).read_bytes()
    outcome = keymint(*verb, provisioned / name, "-w", provisioned, "--json")
    assert (outcome.code, outcome.codes()) == (2, ["output-foreign"])
    assert (provisioned / name).read_bytes() == before


def test_an_earlier_output_and_an_empty_file_are_replaced(keymint: Callable, provisioned: Path) -> None:
    folder = provisioned.parent
    outputs = ["g.svg", "g.dot", "g.html", "a.html", "a.json", "c.sarif", "ca.pem"]
    for name in outputs:
        (folder / name).touch()
    for extra in ((), ("--since", "7d")):
        for name in outputs:
            own = {"a": ("report", *extra, "-o"), "c": ("check", "--sarif")}.get(name[0], ("graph", "-o"))
            words = ("authority", "export", "identity_ca", "-o") if name == "ca.pem" else own
            outcome = keymint(*words, folder / name, "-w", provisioned, "--json")
            assert "output-foreign" not in outcome.codes(), name
            content = (folder / name).read_bytes()
            assert content
            (folder / name).write_bytes(content + b" ")


def test_another_workspace_is_protected_from_an_output_of_the_same_kind(keymint: Callable, provisioned: Path) -> None:
    (provisioned / "build").mkdir(exist_ok=True)
    drawn = provisioned / "build/graph.svg"
    policy = provisioned.parent / "policy.xml"
    policy.write_text(_POLICY)
    assert keymint("graph", policy, "-o", drawn).code == 0
    drawn.write_bytes(drawn.read_bytes() + b" ")
    assert keymint("graph", policy, "-o", drawn, "--json").codes() == ["output-foreign"]


def test_a_foreign_file_that_is_too_large_to_read_is_kept(keymint: Callable, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(_POLICY)
    with (tmp_path / "recording").open("wb") as opened:
        opened.truncate(17 * 1024 * 1024)
    assert keymint("lint", "policy.xml", "--sarif", "recording", "--json").codes() == ["output-foreign"]
    assert (tmp_path / "recording").stat().st_size == 17 * 1024 * 1024
