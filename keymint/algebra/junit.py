"""Unit tests of a policy as JUnit XML, the format that CI servers show test results from."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET  # only writes

from keymint.algebra.expected import Checked

_CONTROL = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(found: Mapping[str, Sequence[Checked]]) -> bytes:
    """Return a test suite for each file, with a test case for each test.

    Args:
        found: checked expectations by file, as the user would type it.
    """
    root = ET.Element("testsuites", name="keymint test")
    for file, checked in found.items():
        cases: dict[str, list[Checked]] = {}
        for each in checked:
            cases.setdefault(each.expectation.test, []).append(each)
        failed = sum(any(each.failure for each in case) for case in cases.values())
        suite = ET.SubElement(
            root, "testsuite", name=file, tests=str(len(cases)), failures=str(failed), errors="0", skipped="0"
        )
        for name, case in cases.items():
            element = ET.SubElement(suite, "testcase", classname=_text(file), name=_text(name))
            broken = [each for each in case if each.failure]
            if broken:
                failure = ET.SubElement(element, "failure", type="expectation", message=_text(broken[0].failure))
                failure.text = _text(
                    "\n".join(f"{file}:{each.expectation.where.line}: {each.failure}" for each in broken)
                )
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _text(text: str) -> str:
    """Return what XML can hold of a text."""
    return _CONTROL.sub("\ufffd", text)
