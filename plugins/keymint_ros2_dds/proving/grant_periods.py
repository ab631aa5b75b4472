# SPDX-License-Identifier: Apache-2.0
"""The periods in which the grants of a document are in force."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from comarmor.values import dataclass
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, PermissionsDocument

_SECOND = timedelta(seconds=1)
_LAST_MOMENT = datetime.max.replace(tzinfo=UTC) - _SECOND


@dataclass(frozen=True, slots=True)
class GrantPeriod:
    """A period in which a grant is in force; it may have others later."""

    grant: DocumentGrant
    begin: datetime
    end: datetime


def grant_periods(document: PermissionsDocument, subject_name: str, semantics: Semantics) -> Iterator[GrantPeriod]:
    """Yield a period for each grant of the identity that is ever in force."""
    grants = semantics.grants(document, subject_name)
    periods = [(grant, period) for grant in grants if (period := semantics.period(grant)) is not None]
    cuts = sorted({begin for _, (begin, _) in periods} | {next_second(end) for _, (_, end) in periods})
    known = set()
    for begin, end in pairwise(cuts):
        at = next((n for n, (_, (first, last)) in enumerate(periods) if first <= begin <= last), None)
        if at is not None and at not in known:
            known.add(at)
            grant, (_, last) = periods[at]
            yield GrantPeriod(grant, begin, last if end == next_second(last) else end - _SECOND)


def next_second(moment: datetime) -> datetime:
    """Return the second after a moment; of the last one its end."""
    return min(moment, _LAST_MOMENT) + _SECOND
