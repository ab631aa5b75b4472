"""How strictly each parser reads a document: which documents it refuses, and of which that is not known.

Every function returns a reason of one line, with its place; or an empty text.
"""

from __future__ import annotations

from enum import StrEnum

from keymint_ros2_dds.reading.quirks import CRASHES, REFUSES, UNMODELLED, Quirk, VendorReading
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument


class Parser(StrEnum):
    """Whose parser reads a document: the standard accepts what its schema allows (DDS Security 1.1, 9.4.1)."""

    STANDARD = "the schema"
    CYCLONE = "Cyclone DDS"
    FAST = "Fast DDS"


def refusal(document: PermissionsDocument | GovernanceDocument, parser: Parser) -> str:
    """Return why a parser refuses a document."""
    if parser is Parser.STANDARD:
        return document.defect
    quirk = _first(document, parser, CRASHES, REFUSES)
    if quirk is None or unmodelled(document, parser):
        return ""
    crashes = _reading(quirk, parser) is CRASHES
    text = f"{quirk.text} crashes {parser}" if crashes else f"{parser} refuses {quirk.text}"
    return f"{document.place(quirk.line)}: {text}"


def unmodelled(document: PermissionsDocument | GovernanceDocument, parser: Parser) -> str:
    """Return why it is not known how a parser reads a document."""
    quirk = None if parser is Parser.STANDARD else _first(document, parser, UNMODELLED)
    return f"{document.place(quirk.line)}: how {parser} reads {quirk.text} is not modelled" if quirk else ""


def _first(
    document: PermissionsDocument | GovernanceDocument, parser: Parser, *readings: VendorReading
) -> Quirk | None:
    return next((quirk for quirk in document.quirks if _reading(quirk, parser) in readings), None)


def _reading(quirk: Quirk, parser: Parser) -> VendorReading:
    return quirk.cyclone if parser is Parser.CYCLONE else quirk.fast
