# SPDX-License-Identifier: Apache-2.0
"""What ends, and from when on it is due, as gauges for a monitor."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from keymint.life.renewal_schedule import CERTIFICATE, LIST, PERMISSIONS, authority_ends, authority_renewals
from keymint.names import subject_of
from keymint.output.openmetrics import Gauge, moments
from keymint.stages.package_status import StatusRow
from keymint.workspace.session import Session


def gauges(session: Session, rows: Sequence[StatusRow]) -> tuple[Gauge, ...]:
    """Return the gauges of the installed enclaves and of the authorities.

    Args:
        session: the workspace and its profile.
        rows: the status of its packages.
    """
    terms = [term for row in rows for term in row.terms]
    lists: dict[str, datetime] = {term.issuer: term.last for term in terms if term.what == LIST}
    due = authority_renewals(session, terms)

    def of_enclaves(what: str) -> list[tuple[dict[str, str], datetime]]:
        return [
            ({"subject": subject_of(row.package)}, term.last) for row in rows for term in row.terms if term.what == what
        ]

    stale = tuple(({"subject": f"/{row.package}"}, float(bool(row.stale))) for row in rows if row.terms)
    return (
        moments("keymint_certificate_expiry", "End of the certificate of an enclave.", of_enclaves(CERTIFICATE)),
        moments("keymint_permissions_expiry", "End of the permissions of an enclave.", of_enclaves(PERMISSIONS)),
        moments(
            "keymint_renew_after",
            "From when on 'keymint renew' renews an enclave; none while its authority must be renewed first.",
            [({"subject": f"/{row.package}"}, row.renew_after) for row in rows],
        ),
        Gauge("keymint_enclave_stale", "1 if an enclave differs from its sources or the policy.", stale),
        moments(
            "keymint_revocation_list_expiry",
            "End of a revocation list; no process starts with an expired one.",
            [({"authority": name}, end) for name, end in lists.items()],
        ),
        moments(
            "keymint_authority_expiry",
            "End of the certificate of an authority.",
            [({"authority": name}, end) for name, end in authority_ends(session).items()],
        ),
        moments(
            "keymint_authority_renew_after",
            "From when on an authority cuts what it signs, so that a person must renew it.",
            [({"authority": name}, moment) for name, moment in due.items()],
        ),
    )
