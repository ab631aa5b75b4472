# SPDX-License-Identifier: Apache-2.0
"""When an enclave is in force: the periods of its grants, as each model reads dates, and of its certificates."""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from itertools import pairwise

from comarmor.text import lazy_regex
from comarmor.values import Data
from keymint.api import ValidityTerm
from keymint.errors import KeymintError, Origin
from keymint.pki import revocation_lists
from keymint.pki.examine import certificate_terms
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.decision.semantics import VARIATIONS, Semantics
from keymint_ros2_dds.enclave_layout import CA, CERTIFICATE, CRL, IDENTITY_CA, PERMISSIONS_CA
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, PermissionsDocument, read

_SECOND = timedelta(seconds=1)
_LAST_MOMENT = datetime.max.replace(tzinfo=UTC) - _SECOND


class GrantPeriod(Data):
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


Period = tuple[datetime, datetime]
_PLAIN = frozenset(f"{string.ascii_letters}{string.digits}_/=,".encode())
_TOPIC = lazy_regex(rb"<topic>[A-Za-z0-9_/*]+</topic>")
_ANYONE = "CN=/n"


def of_certificates(files: Mapping[str, bytes], folder: str) -> Iterator[ValidityTerm]:
    """Yield a term for each certificate of an enclave, and for its revocation list.

    Raises:
        KeymintError: a file contains no certificate.
    """
    names = (name for name in (CERTIFICATE, IDENTITY_CA, PERMISSIONS_CA, CA) if name in files)
    yield from certificate_terms(files, folder, names)
    if CRL in files and (revocations := revocation_lists.period_in(files[CRL])):
        yield ValidityTerm("revocation-list", "the revocation list", Origin(f"{folder}/{CRL}"), (revocations,))


def of_grants(
    content: bytes, place: tuple[str, int], subject_name: str, models: tuple[str, ...]
) -> Iterator[ValidityTerm]:
    """Yield the periods in which a grant is in force, by model; models that agree share a term.

    A model that refuses the document, or has no matching grant in it, yields no term; a claim reports that.

    Args:
        content: the permissions document, unsigned.
        place: its file, and the number of lines before it there.
        subject_name: the identity's, in the order of RFC 2253.
        models: their names.

    Raises:
        KeymintError: the document cannot be read.
    """
    file, offset = place
    try:
        grants = _grants(*_representative(content, subject_name), models)
    except KeymintError:
        read(content, file, offset)  # raises the error with its place
        raise
    for line, periods, agreeing in grants:
        yield ValidityTerm("grant", f"the grant of {subject_name!r}", Origin(file, line + offset), periods, agreeing)


def _representative(content: bytes, subject_name: str) -> tuple[bytes, str]:
    """Return a document and a subject name whose grants are in force at the same times, for all alike documents.

    Without comments and sections, ``<topic>`` with plain text is an element wherever it stands, and every model reads
    it alike. It has no part in the times of a grant. Nor have the name and the subject of the only grant, if that is
    the identity's by every comparison. Each is replaced by another plain text; the line of the grant stays.
    """
    before, _, grant = content.partition(b'<grant name="')
    name, _, rest = grant.partition(b'">')
    subject = subject_name.encode()
    blanks, found, after = rest.partition(b"<subject_name>%b<" % subject)
    if (
        not found
        or blanks.strip()
        or not name
        or not _PLAIN.issuperset(name + subject)
        or content.count(b"<grant") != 1
        or b"<!" in content
        or subject_name.count("/") + subject_name.count(",") >= subject_names.MAX_TOKENS
    ):
        return content, subject_name
    alike = (before, b'<grant name="/n">', blanks, b"<subject_name>CN=/n<", after)
    return _TOPIC.sub(b"<topic>t</topic>", b"".join(alike)), _ANYONE


@lru_cache(maxsize=16)
def _grants(
    content: bytes, subject_name: str, models: tuple[str, ...]
) -> tuple[tuple[int, tuple[Period, ...], tuple[str, ...]], ...]:
    """Return the line of each grant that is in force for some models, its periods, and the models."""
    document = read(content)
    together: dict[tuple[int, tuple[Period, ...]], list[str]] = {}
    for name in models:
        semantics = VARIATIONS[name].semantics
        if semantics.refusal(document) or semantics.unmodelled(document):
            continue
        grants = semantics.grants(document, subject_name)
        if grants:
            periods = joined_periods(filter(None, map(semantics.period, grants)))
            together.setdefault((grants[0].line, periods), []).append(name)
    return tuple((line, periods, tuple(names)) for (line, periods), names in together.items())


def joined_periods(periods: Iterable[Period]) -> tuple[Period, ...]:
    """Return periods in order; those that touch or overlap become one. Dates have a resolution of a second."""
    merged: list[Period] = []
    for first, last in sorted(periods):
        if merged and first <= next_second(merged[-1][1]):
            merged[-1] = (merged[-1][0], max(merged[-1][1], last))
        else:
            merged.append((first, last))
    return tuple(merged)
