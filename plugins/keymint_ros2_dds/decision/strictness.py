"""How strictly each parser reads a document: which documents it refuses, and of which that is not known.

Every function returns a reason of one line, with its place; or an empty text.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from functools import lru_cache

from keymint_ros2_dds.domains import MAX_DOMAIN
from keymint_ros2_dds.reading import dates, domain_ids
from keymint_ros2_dds.reading.quirks import FINE, REFUSES, STOPS, UNMODELLED, Quirk, VendorReading
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import (
    BLANKS,
    DocumentCriteria,
    DocumentGrant,
    DocumentRule,
    PermissionsDocument,
)


class Parser(StrEnum):
    """Whose parser reads a document: the standard accepts what its schema allows (DDS Security 1.1, 9.4.1)."""

    STANDARD = "the schema"
    CYCLONE = "Cyclone DDS"
    FAST = "Fast DDS"


def refusal(document: PermissionsDocument | GovernanceDocument, parser: Parser) -> str:
    """Return why a parser refuses a document."""
    if parser is Parser.STANDARD:
        return document.defect
    return _reason(document, parser, REFUSES, STOPS)


def unmodelled(document: PermissionsDocument | GovernanceDocument, parser: Parser) -> str:
    """Return why it is not known how a parser reads a document."""
    return "" if parser is Parser.STANDARD else _reason(document, parser, UNMODELLED)


def crash(document: PermissionsDocument) -> str:
    """Return why Cyclone DDS 0.10 crashes when it reads a document, as a reason not to give it to the plugin."""
    quirk = next((each for each in _quirks(document) if each.cyclone is STOPS), None)
    return f"line {quirk.line}: {quirk.text} stops {Parser.CYCLONE}" if quirk else ""


def _reason(document: PermissionsDocument | GovernanceDocument, parser: Parser, *readings: VendorReading) -> str:
    for quirk in _quirks(document):
        reading = quirk.cyclone if parser is Parser.CYCLONE else quirk.fast
        if reading in readings:
            place = document.place(quirk.line)
            if reading is STOPS:
                return f"{place}: {quirk.text} stops {parser}"
            if reading is UNMODELLED:
                return f"{place}: how {parser} reads {quirk.text} is not modelled"
            return f"{place}: {parser} refuses {quirk.text}"
    return ""


def _quirks(document: PermissionsDocument | GovernanceDocument) -> tuple[Quirk, ...]:
    return document.peculiarities if isinstance(document, GovernanceDocument) else peculiarities(document)


# Asked for each vendor, twice: whether it refuses, and whether that is known.
@lru_cache(maxsize=4)
def peculiarities(document: PermissionsDocument) -> tuple[Quirk, ...]:
    """Return what a plain document has not: of its bytes, and of what it says."""
    return tuple(_peculiarities(document))


def _peculiarities(document: PermissionsDocument) -> Iterator[Quirk]:
    explained = False
    if not (document.grants or document.peculiarities):
        yield Quirk(1, "a document without a grant", REFUSES, REFUSES, invalid=True)
    for each in (*document.peculiarities, *(found for grant in document.grants for found in _of_grant(grant))):
        explained |= each.invalid
        yield each
    if document.defects and not explained:
        where = document.defects[0].where
        at = where.line - document.offset if where and where.line else 1
        yield Quirk(at, f"what the schema does not allow ({document.defects[0].message})", UNMODELLED, UNMODELLED)


def _of_grant(grant: DocumentGrant) -> Iterator[Quirk]:
    def odd(text: str, cyclone: VendorReading, fast: VendorReading) -> Quirk:
        return Quirk(grant.line, text, cyclone, fast, invalid=True)

    if grant.name is None:
        yield odd("a grant without a name", FINE, REFUSES)
    if not grant.subject_name.strip(BLANKS):
        yield odd("a grant without a subject name", REFUSES, REFUSES)
    for name, text in (("not_before", grant.not_before), ("not_after", grant.not_after)):
        yield from _date(grant, name, text)
    if grant.default is None:
        yield odd("a grant without a default", FINE, REFUSES)
    elif not grant.default.strip(BLANKS):
        yield odd("an empty <default>", STOPS, REFUSES)
    elif grant.default not in {"ALLOW", "DENY"}:
        yield odd(f"the default {grant.default!r}", FINE, REFUSES)
    for at, rule in enumerate(grant.rules):
        for each in _of_rule(rule):
            # Fast DDS does not look at what comes after the default.
            fast = each.fast if at < grant.before_default else FINE
            yield Quirk(each.line, each.text, each.cyclone, fast, each.invalid)


def _date(grant: DocumentGrant, name: str, text: str) -> Iterator[Quirk]:
    if not text.strip(BLANKS):
        fast = STOPS if name == "not_after" else REFUSES
        yield Quirk(grant.line, f"an empty <{name}>", REFUSES, fast, invalid=True)
        return
    if dates.fast(text) is None:
        fast = UNMODELLED if dates.fast_may_read(text) else REFUSES
        yield Quirk(grant.line, f"the date {text!r}", FINE, fast, invalid=True)
    elif not dates.is_plain(text):
        yield Quirk(grant.line, f"the date {text!r}", FINE, FINE, invalid=True)


def _of_rule(rule: DocumentRule) -> Iterator[Quirk]:
    def odd(text: str, cyclone: VendorReading, fast: VendorReading, *, invalid: bool = True) -> Quirk:
        return Quirk(rule.line, text, cyclone, fast, invalid)

    if not rule.bounded:
        yield odd("a rule without domains", STOPS, REFUSES)
    elif not rule.domains:
        yield odd("an empty list of domains", FINE, REFUSES)
    for item in rule.domains:
        if item.first is None and item.last is None:
            yield odd("an empty range of domains", STOPS, REFUSES)
        elif item.first is None:
            yield odd("a range of domains without a minimum", STOPS, FINE, invalid=False)
        for text in item.texts:
            yield from _number(rule, text)
    for criteria in rule.criteria:
        yield from _of_criteria(criteria)


def _number(rule: DocumentRule, text: str) -> Iterator[Quirk]:
    found = domain_ids.in_c(text)
    invalid = int(text) < 0
    if found == domain_ids.REFUSED:
        yield Quirk(rule.line, f"the domain id {text.strip(BLANKS)}", REFUSES, FINE, invalid)
    elif found > MAX_DOMAIN:
        yield Quirk(rule.line, f"a domain id above {MAX_DOMAIN}", REFUSES, FINE, invalid)


def _of_criteria(criteria: DocumentCriteria) -> Iterator[Quirk]:
    def odd(text: str, cyclone: VendorReading, fast: VendorReading, *, invalid: bool = True) -> Quirk:
        return Quirk(criteria.line, text, FINE if criteria.action == "relay" else cyclone, fast, invalid)

    if not criteria.listed:
        yield odd(f"a <{criteria.action}> without topics", FINE, FINE)
    elif not criteria.topics:
        yield odd("an empty list of topics", FINE, REFUSES)
    if any(not topic.strip(BLANKS) for topic in criteria.topics):
        yield odd("an empty topic", STOPS, REFUSES, invalid="" in criteria.topics)
    names = (*criteria.topics, *(criteria.partitions or ()))
    if any("\n" in name.strip(BLANKS) for name in names):
        # The parser of Cyclone DDS keeps the carriage return that S/MIME puts before it.
        yield odd("a line end within a name", UNMODELLED, FINE, invalid=False)
    if criteria.partitions == ():
        yield odd("an empty list of partitions", FINE, REFUSES)
