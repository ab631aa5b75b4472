# SPDX-License-Identifier: Apache-2.0
"""Ranges of DDS domain ids."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from keymint.api import DomainRange
from keymint.errors import Diagnostic, Origin

MAX_DOMAIN = 230
"""The highest domain id whose ports exist (DDSI-RTPS 2.3, 9.6.1.1); Cyclone DDS refuses documents with higher ones."""


def merged_domains(ranges: Iterable[DomainRange]) -> Sequence[DomainRange]:
    """Return ranges of domains in order; ranges that overlap or touch become one."""
    result: list[DomainRange] = []
    for item in sorted(ranges):
        if result and item.first <= result[-1].last + 1:
            result[-1] = DomainRange(result[-1].first, max(result[-1].last, item.last))
        else:
            result.append(item)
    return result


def uncovered_domains(ranges: Iterable[DomainRange], covering: Iterable[DomainRange]) -> tuple[DomainRange, ...]:
    """Return the ranges that are not fully within other ranges."""
    outer = merged_domains(covering)
    return tuple(item for item in ranges if not any(o.first <= item.first and item.last <= o.last for o in outer))


def in_words(ranges: Iterable[DomainRange]) -> str:
    """Return ranges of domains as text: ``domain 3``, ``domains 3 to 5``, ``domains 0, 3 to 5``, ``no domain``."""
    texts = [str(e.first) if e.first == e.last else f"{e.first} to {e.last}" for e in merged_domains(ranges)]
    if not texts:
        return "no domain"
    plural = len(texts) > 1 or " to " in texts[0]
    return f"domain{'s' if plural else ''} {', '.join(texts)}"


def check_domains(ranges: Sequence[DomainRange], where: Origin, subject: str) -> Iterator[Diagnostic]:
    """Yield the defects of a list of domains: empty, an empty range, or an id that has no ports."""
    if not ranges:
        yield Diagnostic.error("domains", "no domain is given", where, "name at least one", subject)
    for item in ranges:
        if item.first > item.last or item.first < 0:
            message = f"the range of domains {item.first} to {item.last} is empty"
            yield Diagnostic.error("domains", message, where, "put the lower id first", subject)
        elif item.last > MAX_DOMAIN:
            message = f"domain {item.last} is higher than {MAX_DOMAIN}; Cyclone DDS refuses the document"
            yield Diagnostic.error("portability-domain", message, where, f"use 0 to {MAX_DOMAIN}", subject)
