# SPDX-License-Identifier: Apache-2.0
"""JUnit XML, the format in which CI servers read test results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from comarmor.text import lazy_regex
from comarmor.values import Data
from keymint.api.xml_templates import xml_document

_CONTROL = lazy_regex(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class JUnitCase(Data):
    """A test case.

    Attributes:
        class_name: what it belongs to.
        name: its name.
        failure: why it failed: the type of the failure, and one line; None if it passed.
        details: further lines about the failure.
    """

    class_name: str
    name: str
    failure: tuple[str, str] | None = None
    details: str = ""


def junit(title: str, suites: Mapping[str, Sequence[JUnitCase]]) -> bytes:
    """Return the results of a run, e.g. of ``keymint test``, as a document.

    Args:
        title: the run.
        suites: test cases that belong together, by the name of what they are about.
    """
    return xml_document(Path(__file__).with_suffix(".xml.j2"), title=title, suites=suites, legal=_legal)


def _legal(text: str) -> str:
    """Replace the characters that XML cannot contain (XML 1.0, 2.2)."""
    return _CONTROL.sub("\ufffd", text)
