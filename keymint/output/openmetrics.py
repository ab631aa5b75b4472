# SPDX-License-Identifier: Apache-2.0
"""Gauges as text for a monitor, in the format OpenMetrics 1.0 (https://openmetrics.io), which Prometheus reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime

from comarmor.values import Data
from keymint.life.renewal_schedule import CERTIFICATE, LIST, PERMISSIONS, authority_ends, authority_renewals
from keymint.names import subject_of
from keymint.stages.package_status import StatusRow
from keymint.workspace.session import Session

_ESCAPED = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})


class Gauge(Data):
    """A gauge with its values.

    Attributes:
        name: its name; ``_seconds`` at its end is its unit.
        help: what it says, one sentence.
        label: name of the label of its values.
        values: its values by the text of that label.
    """

    name: str
    help: str
    label: str
    values: Mapping[str, float]


def moments(name: str, help_: str, label: str, ends: Mapping[str, datetime | None]) -> Gauge:
    """Return a gauge of moments, in seconds since 1970; what has no moment has no value."""
    values = {text: moment.timestamp() for text, moment in ends.items() if moment is not None}
    return Gauge(f"keymint_{name}_timestamp_seconds", help_, label, values)


def openmetrics(gauges: Iterable[Gauge]) -> Iterator[str]:
    """Yield the lines of the text, without line ends."""
    for gauge in gauges:
        yield f"# TYPE {gauge.name} gauge"
        if gauge.name.endswith("_seconds"):
            yield f"# UNIT {gauge.name} seconds"
        yield f"# HELP {gauge.name} {gauge.help.translate(_ESCAPED)}"
        for text, value in gauge.values.items():
            yield f'{gauge.name}{{{gauge.label}="{text.translate(_ESCAPED)}"}} {value:.15g}'
    yield "# EOF"


def gauges(session: Session, rows: Sequence[StatusRow]) -> tuple[Gauge, ...]:
    """Return the gauges of the installed enclaves and of the authorities.

    Args:
        session: the workspace and its profile.
        rows: the status of its packages.
    """
    terms = [term for row in rows for term in row.terms]
    lists = {term.issuer: term.last for term in terms if term.what == LIST}

    def of_enclaves(what: str) -> dict[str, datetime | None]:
        return {subject_of(row.package): term.last for row in rows for term in row.terms if term.what == what}

    enclaves = (
        ("certificate_expiry", "End of the certificate of an enclave.", of_enclaves(CERTIFICATE)),
        ("permissions_expiry", "End of the permissions of an enclave.", of_enclaves(PERMISSIONS)),
        (
            "renew_after",
            "Date from which 'keymint renew' renews an enclave; none while its authority must be renewed first.",
            {f"/{row.package}": row.renew_after for row in rows},
        ),
    )
    stale = {f"/{row.package}": float(bool(row.stale)) for row in rows if row.terms}
    authorities = (
        ("revocation_list_expiry", "End of a revocation list; no process starts with an expired one.", lists),
        ("authority_expiry", "End of the certificate of an authority.", authority_ends(session)),
        (
            "authority_renew_after",
            "Date from which an authority shortens what it signs, so that a person must renew it.",
            authority_renewals(session, terms),
        ),
    )
    return (
        *(moments(name, help_, "subject", ends) for name, help_, ends in enclaves),
        Gauge("keymint_enclave_stale", "1 if an enclave differs from its sources or the policy.", "subject", stale),
        *(moments(name, help_, "authority", ends) for name, help_, ends in authorities),
    )
