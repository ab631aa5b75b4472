# SPDX-License-Identifier: Apache-2.0
"""Collect the periods of validity of an enclave: of its certificates, and of its grants as each model reads dates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache

from comarmor.errors import Origin
from keymint.api import ValidityTerm
from keymint.errors import KeymintError
from keymint.pki import certificates, distinguished_names
from keymint_ros2_dds.credentials import revocation_period
from keymint_ros2_dds.decision import VARIATIONS, PermissionsDocument
from keymint_ros2_dds.enclave_layout import CA, CERTIFICATE, CRL, IDENTITY_CA, PERMISSIONS_CA

Period = tuple[datetime, datetime]
_SECOND = timedelta(seconds=1)
_LAST = datetime.max.replace(tzinfo=UTC) - _SECOND


def of_certificates(files: Mapping[str, bytes], folder: str) -> Iterator[ValidityTerm]:
    """Yield a term for each certificate of an enclave, and for its revocation list.

    Raises:
        KeymintError: a file contains no certificate.
    """
    for name in (CERTIFICATE, IDENTITY_CA, PERMISSIONS_CA, CA):
        if name in files:
            code = "certificate" if name == CERTIFICATE else "authority"
            where = Origin(f"{folder}/{name}")
            try:
                periods = _certificates(files[name])
            except KeymintError as error:
                raise KeymintError.of([replace(diagnostic, where=where) for diagnostic in error.diagnostics]) from None
            for subject, period in periods:
                yield ValidityTerm(code, f"the certificate of {subject!r}", where, (period,))
    if CRL in files and (revocations := revocation_period(files[CRL])):
        yield ValidityTerm("revocation-list", "the revocation list", Origin(f"{folder}/{CRL}"), (revocations,))


# Enclaves usually have the same authorities.
@lru_cache(maxsize=64)
def _certificates(pem: bytes) -> tuple[tuple[str, Period], ...]:
    return tuple(
        (
            distinguished_names.to_text(certificate.subject),
            (certificate.not_valid_before_utc, certificate.not_valid_after_utc),
        )
        for certificate in certificates.load_bundle(pem)
    )


def of_grants(document: PermissionsDocument, subject_name: str) -> Iterator[ValidityTerm]:
    """Yield the periods in which a grant is in force, by model; models that agree share a term.

    A model that refuses the document, or has no matching grant in it, yields no term; a claim reports that.

    Args:
        document: the permissions document.
        subject_name: the identity's, in the order of RFC 2253.
    """
    together: dict[tuple[int, tuple[Period, ...]], list[str]] = {}
    for name, variation in VARIATIONS.items():
        semantics = variation.semantics
        if semantics.refusal(document) or semantics.unmodelled(document):
            continue
        grants = semantics.grants(document, subject_name)
        if grants:
            periods = joined(filter(None, map(semantics.period, grants)))
            together.setdefault((grants[0].line, periods), []).append(name)
    for (line, periods), models in together.items():
        where = Origin(document.file, line + document.offset)
        yield ValidityTerm("grant", f"the grant of {subject_name!r}", where, periods, tuple(models))


def joined(periods: Iterable[Period]) -> tuple[Period, ...]:
    """Return periods in order; those that touch or overlap become one. Dates have a resolution of a second."""
    merged: list[Period] = []
    for first, last in sorted(periods):
        if merged and first <= min(merged[-1][1], _LAST) + _SECOND:
            merged[-1] = (merged[-1][0], max(merged[-1][1], last))
        else:
            merged.append((first, last))
    return tuple(merged)
