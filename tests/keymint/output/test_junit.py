# SPDX-License-Identifier: Apache-2.0
"""JUnit XML, as CI servers read it."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from keymint.output.junit import JUnitCase, JUnitFailure, JUnitSuite, junit


def test_suites_count_their_cases_and_failures() -> None:
    failure = JUnitFailure("expectation", "expected to be denied", "p.test.xml:3: expected to be denied")
    suite = JUnitSuite("p.test.xml", [JUnitCase("p", "good"), JUnitCase("p", "bad", failure)])
    (element,) = ET.fromstring(junit("keymint test", [suite]))
    assert (element.get("tests"), element.get("failures"), element.get("errors")) == ("2", "1", "0")
    good, bad = element
    assert good.find("failure") is None
    assert bad.findtext("failure") == failure.details
    assert (bad.attrib["classname"], bad.find("failure").attrib["type"]) == ("p", "expectation")  # type: ignore[union-attr]


def test_characters_that_xml_cannot_contain_are_replaced() -> None:
    case = JUnitCase("p\x00", "a\x1b[31m", JUnitFailure("kind", "\ud800", "line\nnext\x0b"))
    (suite,) = ET.fromstring(junit("title", [JUnitSuite("s", [case])]))
    (element,) = suite
    assert element.attrib == {"classname": "p\ufffd", "name": "a\ufffd[31m"}
    assert element.findtext("failure") == "line\nnext\ufffd"
