"""When grants are in force, and in which domains claims hold: ranges, put together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from keymint.api import DomainRange
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, PermissionsDocument

_SECOND = timedelta(seconds=1)
_LAST_MOMENT = datetime.max.replace(tzinfo=UTC) - _SECOND


@dataclass(frozen=True, slots=True)
class GrantPeriod:
    """A time at which a grant is in force; others may follow in which it is, too."""

    grant: DocumentGrant
    begin: datetime
    end: datetime


def grant_periods(document: PermissionsDocument, subject_name: str, semantics: Semantics) -> Iterator[GrantPeriod]:
    """Yield a time at which each grant that is about the identity is in force; grants that never are have none."""
    grants = semantics.grants(document, subject_name)
    if not semantics.passes_over_invalid:
        grants = grants[:1]
    if len(grants) == 1:
        if (only := semantics.period(grants[0])) is not None:
            yield GrantPeriod(grants[0], *only)
        return
    periods = [(grant, period) for grant in grants if (period := semantics.period(grant)) is not None]
    cuts = sorted({begin for _, (begin, _) in periods} | {_next(end) for _, (_, end) in periods})
    known = set()
    for begin, following in pairwise(cuts):
        at = next((n for n, (_, (first, last)) in enumerate(periods) if first <= begin <= last), None)
        if at is not None and at not in known:
            known.add(at)
            yield GrantPeriod(periods[at][0], begin, following - _SECOND)


def _next(moment: datetime) -> datetime:
    return moment + _SECOND if moment < _LAST_MOMENT else moment


def joined(domains: Sequence[DomainRange]) -> Iterator[DomainRange]:
    """Yield ranges of domains, neighbours as one."""
    first, last = domains[0].first, domains[0].last
    for each in domains[1:]:
        if each.first == last + 1:
            last = each.last
        else:
            yield DomainRange(first, last)
            first, last = each.first, each.last
    yield DomainRange(first, last)
