"""What all JUnit XML has in common, the format that CI servers show test results from."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET  # only writes

_CONTROL = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def rendered(root: ET.Element) -> bytes:
    """Return a document, indented."""
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def legal(text: str) -> str:
    """Return what XML can hold of a text (XML 1.0, 2.2)."""
    return _CONTROL.sub("\ufffd", text)
