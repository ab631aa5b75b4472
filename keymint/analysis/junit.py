"""Unit tests of a policy as JUnit XML, the format that CI servers show test results from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET  # only writes

from keymint.analysis.policy_tests import ExpectationResult
from keymint.output.junit import legal, rendered


def junit(found: Mapping[str, Sequence[ExpectationResult]]) -> bytes:
    """Return a test suite for each file, with a test case for each test.

    Args:
        found: checked expectations by file, as the user would type it.
    """
    root = ET.Element("testsuites", name="keymint test")
    for file, checked in found.items():
        cases: dict[str, list[ExpectationResult]] = {}
        for each in checked:
            cases.setdefault(each.expectation.test, []).append(each)
        failed = sum(any(each.failure for each in case) for case in cases.values())
        suite = ET.SubElement(
            root, "testsuite", name=file, tests=str(len(cases)), failures=str(failed), errors="0", skipped="0"
        )
        for name, case in cases.items():
            element = ET.SubElement(suite, "testcase", classname=legal(file), name=legal(name))
            broken = [each for each in case if each.failure]
            if broken:
                failure = ET.SubElement(element, "failure", type="expectation", message=legal(broken[0].failure))
                failure.text = legal(
                    "\n".join(f"{file}:{each.expectation.where.line}: {each.failure}" for each in broken)
                )
    return rendered(root)
