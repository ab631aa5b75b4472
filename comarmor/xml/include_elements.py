# SPDX-License-Identifier: Apache-2.0
"""What Keymint's own formats accept as an ``xi:include`` element (XInclude 1.0, W3C 2006): an XML file as a whole."""

from __future__ import annotations

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.text import did_you_mean, quoted
from comarmor.xml.reader import line


def href_of(element: etree._Element, where: Origin) -> str:
    """Return the ``href`` of an ``xi:include`` element that includes an XML file as a whole.

    Raises:
        ComArmorError: it has another attribute, includes text, or has a fallback.
    """
    for attribute in element.attrib:
        if attribute not in ("href", "parse"):
            raise ComArmorError(
                f"xi:include has the attribute {quoted(str(attribute))}, expected only href and parse",
                where=where,
                help=did_you_mean(str(attribute), ("href", "parse")),
                code="schema",
            )
    if element.get("parse", "xml") != "xml":
        raise ComArmorError('xi:include can only have parse="xml"', where=where, code="include-parse")
    if len(element):
        raise ComArmorError(
            "xi:include must be empty; xi:fallback is not supported",
            where=Origin(where.file, line(element[0]), where.chain),
            help="a missing include is an error, so that no rule is ever left out silently",
            code="include-fallback",
        )
    return element.get("href", "")
