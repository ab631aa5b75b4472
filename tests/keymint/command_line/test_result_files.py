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
