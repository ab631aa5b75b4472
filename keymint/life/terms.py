# SPDX-License-Identifier: Apache-2.0
"""When documents are in force, and when they are due: those that a proof rests on, and those of the sources.

A grant permits nothing outside its validity, or after its authority's certificate expired; a certificate ends at the
latest with its issuer's. Build and install work anyway, and warn at each run, not only at the first.
"""

from __future__ import annotations

import json
import os.path
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import lru_cache

from comarmor.values import Data, replace
from keymint.api import Package, Validity, ValidityTerm
from keymint.authority.authority_files import with_issuers
from keymint.errors import Diagnostic, Origin, Severity
from keymint.names import name_of, subject_of
from keymint.view.stamps import Stamp
from keymint.workspace.session import Session
from keymint.workspace.workspace import Workspace

_HELP_BY_CODE = {
    "authority": "'keymint authority renew' issues it again for the same key",
    "revocation-list": "'keymint crl --refresh' issues it again",
}
_LATER = "compare the clock of this machine, or let it begin earlier"


class Threshold(Data):
    """When something is due for renewal.

    Attributes:
        share: after this part of its validity, from 0 to 1.
        left: if it ends within this time; None if the share counts. It is due after half of its validity at the
            earliest, so that what is shorter is not renewed again and again.
    """

    share: float = 0.66
    left: timedelta | None = None

    def moment(self, first: datetime, last: datetime) -> datetime:
        """Return from when on something with this validity is due, in whole seconds."""
        if self.left is None:
            after = first + (last - first) * self.share
        else:
            after = max(last - self.left, first + (last - first) / 2)
        return after.replace(microsecond=0)


DEFAULT = Threshold()
"""Two thirds of the validity, as ``step ca renew`` has it."""


class Term(Data):
    """When one document of an enclave is in force.

    Attributes:
        what: ``certificate``, ``grant``, ``authority`` or ``revocation list``.
        first: its first moment, UTC.
        last: the last moment in which it is in force, UTC.
        where: where its validity is written, as the user would type it.
        issuer: name of the authority that signs it.
        is_cut: it ends with its authority, so that nothing is gained before that is renewed.
    """

    what: str
    first: datetime
    last: datetime
    where: Origin
    issuer: str
    is_cut: bool = False

    @property
    def length(self) -> timedelta:
        """The time from begin to end."""
        return self.last - self.first

    def renew_after(self, threshold: Threshold) -> datetime:
        """Return from when on it is due."""
        return threshold.moment(self.first, self.last)

    def until(self, end: datetime | None) -> Term:
        """Return it as it is in force if its authority ends then, UTC; None: that is not known."""
        return self if end is None else replace(self, last=min(self.last, end), is_cut=self.last >= end)


# -- what a proof rests on ---------------------------------------------------------------------------------------------


def iso_time(moment: datetime) -> str:
    """Return a time as ISO 8601 in UTC, to the second."""
    return moment.astimezone(UTC).replace(microsecond=0, tzinfo=None).isoformat() + "Z"


def days_left(end: datetime, now: datetime) -> str:
    """Return the time until an end in days, as a table shows it: ``30 d``."""
    days = (end - now).days
    return f"expired {-days} d ago" if end < now else f"{days} d"


def terms_of(terms: Sequence[ValidityTerm], models: Collection[str]) -> tuple[ValidityTerm, ...]:
    """Return the terms that apply to some models; vendors may read one date differently."""
    applicable = [(term, tuple(model for model in term.models if model in models)) for term in terms]
    chosen = ((term, own) for term, own in applicable if own or not term.models)
    return tuple(term if own == term.models else replace(term, models=own) for term, own in chosen)


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
        named = f" {name_of(subject)}" if subject else ""
        renew = _HELP_BY_CODE.get(term.code, f"'keymint renew{named}' issues it again with later dates")
        if last := end([term], now):
            if last < now + within:
                message = f"{term.what} expires on {iso_time(last)}"
                yield Diagnostic.warning(f"{term.code}-expires", message, term.where, renew, subject)
            continue
        later = next((first for first, _ in term.periods if first > now), None)
        reading = f", as {', '.join(term.models)} read{'s' * (len(term.models) == 1)} its dates" if term.models else ""
        if later is not None:
            code, message = "not-yet-valid", f"is not valid before {iso_time(later)}"
        elif term.periods:
            code, message = "expired", f"expired on {iso_time(term.periods[-1][1])}"
        else:
            code, message = "never-valid", "is never valid"
        text = f"{term.what} {message}{reading}; now is {iso_time(now)}, and nothing is permitted"
        help_ = _LATER if later is not None else renew
        yield Diagnostic.error(f"{term.code}-{code}", text, term.where, help_, subject)


# -- of the sources ----------------------------------------------------------------------------------------------------


def lifetimes(package: Package) -> tuple[Term, ...]:
    """Return the lifetimes of a package's grant, if it has dates, and of its certificate."""
    grant, identity = package.grant, package.identity
    of_grant = (_lifetime("grant", grant.validity, grant.issuer, grant.origin),) if grant.validity else ()
    return (*of_grant, _lifetime("certificate", identity.validity, identity.issuer, identity.origin))


def _lifetime(what: str, validity: Validity, issuer: str, origin: Origin) -> Term:
    return Term(what, validity.not_before, validity.not_after, validity.origin or origin, issuer)


def recorded_terms(session: Session, name: str, stamp: Stamp | None) -> tuple[Term, ...]:
    """Return the lifetimes of a package whose sources did not change, from the record or else from the package.

    Raises:
        KeymintError: the package has defects.
    """
    recorded = _load(stamp.lifetimes, session.workspace) if stamp is not None else None
    return lifetimes(session.package(name)) if recorded is None else recorded


def of_sources(by_package: Mapping[str, Iterable[Term]], session: Session) -> tuple[Diagnostic, ...]:
    """Return a warning for each lifetime that is not in force now, or that outlasts its authority.

    Args:
        by_package: lifetimes by package.
        session: its profile has the authorities.
    """
    specs = {authority.name: authority.certificate for authority in session.profile.authorities}
    issuers = {name: spec.issuer for name, spec in specs.items()}
    terms = [(each, each.what, subject_of(name)) for name, lifetimes in by_package.items() for each in lifetimes]
    named = dict.fromkeys(each.issuer for each, _, _ in terms)
    for name in dict.fromkeys(name for issuer in named for name in with_issuers(issuer, issuers)):
        own = _lifetime("authority", specs[name].validity, specs[name].issuer, specs[name].origin)
        terms.append((own, f"certificate of the authority {name!r}", ""))
    warnings: list[Diagnostic] = []
    quiet, seen = set[Term](), set[int]()  # most packages have the same lifetimes
    for each, what, subject in terms:
        if id(each) in seen or each in quiet:
            seen.add(id(each))
            continue
        before = len(warnings)
        term = ValidityTerm(each.what, f"the {what}", each.where, ((each.first, each.last),))
        # The advice is for all packages that have this lifetime.
        warnings += (replace(one, severity=Severity.WARNING, subject=subject) for one in findings([term], session.now))
        spec = specs.get(each.issuer)
        if spec is not None and each.last > spec.validity.not_after:
            message = (
                f"the {what} lasts until {iso_time(each.last)}, longer than its authority {each.issuer!r}, which ends "
                f"on {iso_time(spec.validity.not_after)} ({spec.validity.origin or spec.origin}): nothing is permitted "
                "after that"
            )
            help_ = "let it end with its authority, or extend the authority"
            warnings.append(Diagnostic.warning(f"{each.what}-outlives-authority", message, each.where, help_, subject))
        if len(warnings) == before:
            quiet.add(each)
    return tuple(dict.fromkeys(warnings))


# The lifetimes of most packages are those of the profile.
@lru_cache(maxsize=64)
def dump(lifetimes: tuple[Term, ...], workspace: Workspace) -> str:
    """Return lifetimes as text, for the record: places are relative to the workspace."""
    rows = []
    for each in lifetimes:
        file = os.path.relpath(workspace.shown_from / each.where.file, workspace.root)
        rows.append((each.what, each.first, each.last, file, each.where.line, each.issuer))
    return json.dumps(rows, separators=(",", ":"), default=datetime.isoformat)


@lru_cache(maxsize=256)
def _load(text: str, workspace: Workspace) -> tuple[Term, ...] | None:
    """Return the lifetimes of :func:`dump`, or None if the text was not written by it."""
    try:
        return tuple(
            Term(
                str(what),
                datetime.fromisoformat(first),
                datetime.fromisoformat(last),
                Origin(workspace.shown(workspace.root / file), int(line)),
                str(issuer),
            )
            for what, first, last, file, line, issuer in json.loads(text)
        )
    except (ValueError, TypeError):
        return None
