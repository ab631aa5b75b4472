# SPDX-License-Identifier: Apache-2.0
"""JUnit XML, as CI servers read it."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from keymint.output.junit import JUnitCase, junit


def test_suites_count_their_cases_and_failures() -> None:
    details = "p.test.xml:3: expected to be denied"
    bad = JUnitCase("p", "bad", ("expectation", "expected to be denied"), details)
    (element,) = ET.fromstring(junit("keymint test", {"p.test.xml": [JUnitCase("p", "good"), bad]}))
    assert (element.get("tests"), element.get("failures"), element.get("errors")) == ("2", "1", "0")
    good, failed = element
    assert good.find("failure") is None
    assert failed.findtext("failure") == details
    assert (failed.attrib["classname"], failed.find("failure").attrib["type"]) == ("p", "expectation")  # type: ignore[union-attr]


def test_characters_that_xml_cannot_contain_are_replaced() -> None:
    case = JUnitCase("p\x00", "a\x1b[31m", ("kind", "\ud800"), "line\nnext\x0b")
    (suite,) = ET.fromstring(junit("title", {"s": [case]}))
    (element,) = suite
    assert element.attrib == {"classname": "p\ufffd", "name": "a\ufffd[31m"}
    assert element.findtext("failure") == "line\nnext\ufffd"
