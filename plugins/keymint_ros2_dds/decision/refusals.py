"""What implementations do with a permissions document as a whole: refuse it, or what is not known.

Every function returns a reason of one line, with its place; or an empty text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

from keymint_ros2_dds.decision import dates, numbers
from keymint_ros2_dds.decision.document import BLANKS, Criteria, Domains, Grant, PermissionsDocument, Rule
from keymint_ros2_dds.decision.peculiar import FINE, REFUSES, STOPS, UNTOLD, Effect, Peculiarity
from keymint_ros2_dds.domains import MAX_DOMAIN

_CYCLONE, _FAST = "Cyclone DDS", "Fast DDS"


def schema_refuses(document: PermissionsDocument) -> str:
    """The standard: what its schema does not allow (DDS Security 1.1, 9.4.1.3)."""
    return f"the schema refuses it: {document.defects[0]}" if document.defects else ""


def nothing_untold(_document: PermissionsDocument) -> str:
    """The standard says everything."""
    return ""


def stops_cyclone(document: PermissionsDocument) -> str:
    """Return what ends the process of Cyclone DDS 0.10 that reads the document, as a reason not to give it."""
    found = next((each for each in peculiarities(document) if each.cyclone is STOPS), None)
    return f"line {found.line}: {found.text} stops {_CYCLONE}" if found else ""


def cyclone_refuses(document: PermissionsDocument) -> str:
    """Cyclone DDS 0.10: what is not in the form that it knows; and what it cannot read to the end."""
    return _reason(document, _CYCLONE, _of_cyclone, REFUSES, STOPS)


def cyclone_untold(document: PermissionsDocument) -> str:
    """What Cyclone DDS 0.10 may read in a way of its own."""
    return _reason(document, _CYCLONE, _of_cyclone, UNTOLD)


def fast_refuses(document: PermissionsDocument) -> str:
    """Fast DDS 2.9: a grant without name or default, lists without members, processing instructions."""
    return _reason(document, _FAST, _of_fast, REFUSES, STOPS)


def fast_untold(document: PermissionsDocument) -> str:
    """What Fast DDS 2.9 may read in a way of its own."""
    return _reason(document, _FAST, _of_fast, UNTOLD)


def covers(domains: Domains, domain: int, *, min_only_is_exact: bool) -> bool:
    """Tell whether a domain id lies in a range."""
    first = domains.first or 0
    last = domains.last
    if last is None:
        return domain == first if min_only_is_exact else domain >= first
    return first <= domain <= last


def _of_cyclone(peculiarity: Peculiarity) -> Effect:
    return peculiarity.cyclone


def _of_fast(peculiarity: Peculiarity) -> Effect:
    return peculiarity.fast


def _reason(
    document: PermissionsDocument, vendor: str, effect: Callable[[Peculiarity], Effect], *effects: Effect
) -> str:
    for each in peculiarities(document):
        found = effect(each)
        if found in effects:
            place = document.place(each.line)
            if found is STOPS:
                return f"{place}: {each.text} stops {vendor}"
            if found is UNTOLD:
                return f"{place}: what {vendor} makes of {each.text} is not part of its model"
            return f"{place}: {vendor} refuses {each.text}"
    return ""


# Asked for each vendor, twice: whether it refuses, and whether that is known.
@lru_cache(maxsize=4)
def peculiarities(document: PermissionsDocument) -> tuple[Peculiarity, ...]:
    """Return what a plain document has not: of its bytes, and of what it says."""
    return tuple(_peculiarities(document))


def _peculiarities(document: PermissionsDocument) -> Iterator[Peculiarity]:
    explained = False
    if not (document.grants or document.peculiarities):
        yield Peculiarity(1, "a document without a grant", REFUSES, REFUSES, invalid=True)
    for each in (*document.peculiarities, *(found for grant in document.grants for found in _of_grant(grant))):
        explained |= each.invalid
        yield each
    if document.defects and not explained:
        where = document.defects[0].where
        at = where.line - document.offset if where and where.line else 1
        yield Peculiarity(at, f"what the schema does not allow ({document.defects[0].message})", UNTOLD, UNTOLD)


def _of_grant(grant: Grant) -> Iterator[Peculiarity]:
    def odd(text: str, cyclone: Effect, fast: Effect) -> Peculiarity:
        return Peculiarity(grant.line, text, cyclone, fast, invalid=True)

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
            yield Peculiarity(each.line, each.text, each.cyclone, fast, each.invalid)


def _date(grant: Grant, name: str, text: str) -> Iterator[Peculiarity]:
    if not text.strip(BLANKS):
        fast = STOPS if name == "not_after" else REFUSES
        yield Peculiarity(grant.line, f"an empty <{name}>", REFUSES, fast, invalid=True)
        return
    if dates.fast(text) is None:
        fast = UNTOLD if dates.fast_may_read(text) else REFUSES
        yield Peculiarity(grant.line, f"the date {text!r}", FINE, fast, invalid=True)
    elif not dates.is_plain(text):
        yield Peculiarity(grant.line, f"the date {text!r}", FINE, FINE, invalid=True)


def _of_rule(rule: Rule) -> Iterator[Peculiarity]:
    def odd(text: str, cyclone: Effect, fast: Effect, *, invalid: bool = True) -> Peculiarity:
        return Peculiarity(rule.line, text, cyclone, fast, invalid)

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


def _number(rule: Rule, text: str) -> Iterator[Peculiarity]:
    found = numbers.in_c(text)
    invalid = int(text) < 0
    if found == numbers.REFUSED:
        yield Peculiarity(rule.line, f"the domain id {text.strip(BLANKS)}", REFUSES, FINE, invalid)
    elif found > MAX_DOMAIN:
        yield Peculiarity(rule.line, f"a domain id above {MAX_DOMAIN}", REFUSES, FINE, invalid)


def _of_criteria(criteria: Criteria) -> Iterator[Peculiarity]:
    def odd(text: str, cyclone: Effect, fast: Effect, *, invalid: bool = True) -> Peculiarity:
        return Peculiarity(criteria.line, text, FINE if criteria.action == "relay" else cyclone, fast, invalid)

    if not criteria.listed:
        yield odd(f"a <{criteria.action}> without topics", FINE, FINE)
    elif not criteria.topics:
        yield odd("an empty list of topics", FINE, REFUSES)
    if any(not topic.strip(BLANKS) for topic in criteria.topics):
        yield odd("an empty topic", STOPS, REFUSES, invalid="" in criteria.topics)
    names = (*criteria.topics, *(criteria.partitions or ()))
    if any("\n" in name.strip(BLANKS) for name in names):
        # The parser of Cyclone DDS keeps the carriage return that S/MIME puts before it.
        yield odd("a line end within a name", UNTOLD, FINE, invalid=False)
    if criteria.partitions == ():
        yield odd("an empty list of partitions", FINE, REFUSES)
