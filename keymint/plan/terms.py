# SPDX-License-Identifier: Apache-2.0
"""Validity periods of the documents that a proof rests on: whether and until when they are in force."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from comarmor.errors import Diagnostic
from keymint.api import ValidityTerm

_HELP = "'keymint renew' issues it again with later dates"
_HELP_BY_CODE = {
    "authority": "'keymint authority renew' issues it again for the same key",
    "revocation-list": "'keymint crl --refresh' issues it again",
}
_LATER = "compare the clock of this machine, or let it begin earlier"


def shown(moment: datetime) -> str:
    """Return a time as ISO 8601 in UTC, to the second."""
    return moment.astimezone(UTC).replace(microsecond=0, tzinfo=None).isoformat() + "Z"


def days_left(end: datetime, now: datetime) -> str:
    """Return the time until an end in days, as a table shows it: ``30 d``."""
    days = (end - now).days
    return f"expired {-days} d ago" if end < now else f"{days} d"


def terms_of(terms: Sequence[ValidityTerm], models: Collection[str]) -> tuple[ValidityTerm, ...]:
    """Return the terms that apply to some models; vendors may read one date differently."""
    applicable = [(term, tuple(model for model in term.models if model in models)) for term in terms]
    return tuple(replace(term, models=own) for term, own in applicable if own or not term.models)


def end(terms: Sequence[ValidityTerm], now: datetime) -> datetime | None:
    """Return the last moment at which all terms are in force, or None if one is not in force now."""
    ends = [next((last for first, last in term.periods if first <= now <= last), None) for term in terms]
    known = [each for each in ends if each is not None]
    return min(known) if known and len(known) == len(ends) else None


def findings(
    terms: Iterable[ValidityTerm], now: datetime, subject: str = "", within: timedelta = timedelta(0)
) -> Iterator[Diagnostic]:
    """Yield an error for each term that is not in force now, and a warning for each that expires within some time."""
    for term in terms:
        renew = _HELP_BY_CODE.get(term.code, _HELP)
        if last := end([term], now):
            if last < now + within:
                message = f"{term.what} expires on {shown(last)}"
                yield Diagnostic.warning(f"{term.code}-expires", message, term.where, renew, subject)
            continue
        later = next((first for first, _ in term.periods if first > now), None)
        reading = f", as {', '.join(term.models)} read{'s' * (len(term.models) == 1)} its dates" if term.models else ""
        if later is not None:
            code, message = "not-yet-valid", f"is not valid before {shown(later)}"
        elif term.periods:
            code, message = "expired", f"expired on {shown(term.periods[-1][1])}"
        else:
            code, message = "never-valid", "is never valid"
        text = f"{term.what} {message}{reading}; now is {shown(now)}, and nothing is permitted"
        help_ = _LATER if later is not None else renew
        yield Diagnostic.error(f"{term.code}-{code}", text, term.where, help_, subject)
