# SPDX-License-Identifier: Apache-2.0
"""JUnit XML, the format in which CI servers read test results."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET  # only writes

from comarmor.regex import lazy_regex
from comarmor.values import dataclass

_CONTROL = lazy_regex(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class JUnitFailure:
    """Why a test case failed: the type of the failure, one line, and the details."""

    kind: str
    message: str
    details: str


@dataclass(frozen=True, slots=True)
class JUnitCase:
    """A test case; without a failure it passed."""

    class_name: str
    name: str
    failure: JUnitFailure | None = None


@dataclass(frozen=True, slots=True)
class JUnitSuite:
    """Test cases that belong together."""

    name: str
    cases: Sequence[JUnitCase]


def junit(title: str, suites: Sequence[JUnitSuite]) -> bytes:
    """Return the results of a run, e.g. of ``keymint test``, as a document."""
    root = ET.Element("testsuites", name=title)
    for suite in suites:
        element = ET.SubElement(
            root,
            "testsuite",
            name=suite.name,
            tests=str(len(suite.cases)),
            failures=str(sum(case.failure is not None for case in suite.cases)),
            errors="0",
            skipped="0",
        )
        for case in suite.cases:
            tested = ET.SubElement(element, "testcase", classname=_legal(case.class_name), name=_legal(case.name))
            if (failed := case.failure) is not None:
                failure = ET.SubElement(tested, "failure", type=failed.kind, message=_legal(failed.message))
                failure.text = _legal(failed.details)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _legal(text: str) -> str:
    """Replace the characters that XML cannot contain (XML 1.0, 2.2)."""
    return _CONTROL.sub("\ufffd", text)
