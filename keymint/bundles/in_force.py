# SPDX-License-Identifier: Apache-2.0
"""Would nodes start with a bundle now? Dates, certification path and revocation lists."""

from __future__ import annotations

from datetime import datetime

from comarmor.errors import Origin
from keymint.bundles.bundle import CERTIFICATE, Bundle
from keymint.errors import KeymintError
from keymint.pki import certification_path, revocation_lists


def require_in_force(bundle: Bundle, now: datetime, where: Origin) -> None:
    """Require that nodes start with a bundle now: a list that has expired, e.g., keeps every node from starting.

    Args:
        bundle: the bundle.
        now: the clock, UTC.
        where: its file, for messages.

    Raises:
        KeymintError: ``bundle-dates``, ``bundle-chain`` or ``bundle-revoked``.
    """
    manifest = bundle.manifest
    if not manifest.not_before <= now <= manifest.not_after:
        raise KeymintError(
            f"it is in force from {manifest.not_before:%Y-%m-%dT%H:%M:%SZ} to {manifest.not_after:%Y-%m-%dT%H:%M:%SZ}, "
            f"and the clock of this machine is at {now:%Y-%m-%dT%H:%M:%SZ}",
            where=where,
            help="set the clock, or ask the authority for a new bundle",
            code="bundle-dates",
        )
    chain = next(bundle.files[name] for name, each in bundle.authorities.items() if bundle.signer in each)
    problems = certification_path.verify_chain(bundle.files[CERTIFICATE], chain, now, where)
    if problems:
        raise KeymintError(
            f"its certificate is not valid: {problems[0].message}",
            where=where,
            help="ask the authority for a new bundle",
            code="bundle-chain",
        )
    authorities = [each for of_file in bundle.authorities.values() for each in of_file]
    for listed in bundle.lists:
        by = [each for each in authorities if revocation_lists.is_by(listed, each)]
        begin, end = revocation_lists.period(listed)
        if not by or not begin <= now <= end:
            raise KeymintError(
                "it has a revocation list that is not in force, or by another authority: nodes would not start",
                where=where,
                help="ask the authority for a new bundle; 'keymint crl --refresh' issues the list again",
                code="bundle-revoked",
            )
        if by == [bundle.signer] and listed.get_revoked_certificate_by_serial_number(bundle.certificate.serial_number):
            raise KeymintError(
                "its revocation list revokes its own certificate: nodes would not start",
                where=where,
                help="ask the authority for a new bundle",
                code="bundle-revoked",
            )
