# SPDX-License-Identifier: Apache-2.0
"""What formats accept as an ``xi:include`` element (XInclude 1.0, W3C 2006): it includes an XML file."""

from __future__ import annotations

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.text import did_you_mean, quoted
from comarmor.xml.reader import line


def href_of(element: etree._Element, where: Origin, known: tuple[str, ...] = ("href", "parse")) -> str:
    """Return the ``href`` of an ``xi:include`` element that includes an XML file.

    Args:
        element: the element.
        where: its place.
        known: the attributes of the format; without ``xpointer`` the file is included as a whole.

    Raises:
        ComArmorError: it has another attribute, includes text, or has a fallback.
    """
    for attribute in map(str, element.attrib):
        if attribute not in known:
            expected = f"{', '.join(known[:-1])} and {known[-1]}"
            raise ComArmorError(
                f"xi:include has the attribute {quoted(attribute)}, expected only {expected}",
                where=where,
                help=did_you_mean(attribute, known),
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
