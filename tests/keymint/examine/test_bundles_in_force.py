# SPDX-License-Identifier: Apache-2.0
"""A robot takes no bundle with which its nodes would not start."""

from __future__ import annotations

from datetime import datetime, timedelta

import pytest

from keymint.errors import KeymintError
from keymint.examine.bundles import Owner, accept
from keymint.pki import certificates, keys
from tests.keymint.robots.conftest import AT, DAY, FILE, NONCE, Made, authority, keystore, revocations, robot_key, spec

FIRST = Made(nonce=NONCE)
THERE = keystore(FIRST.installed())
NEXT = FIRST.but(nonce="", issue=6)


def code(made: Made, owner: Owner | None = None, now: datetime = AT, of: Made = FIRST) -> str:
    with pytest.raises(KeymintError) as refused:
        accept(made.bundle, keystore(of.installed()), owner or Owner(), now, FILE)
    [diagnostic] = refused.value.diagnostics
    assert diagnostic.where == FILE
    assert diagnostic.help
    return diagnostic.code


@pytest.mark.parametrize("now", [AT - 2 * DAY, AT + 301 * DAY])
def test_the_clock_is_within_the_dates(now: datetime) -> None:
    assert code(NEXT, now=now) == "bundle-dates"


def test_an_authority_that_expired() -> None:
    """Dates of the manifest are not taken for those of the chain."""
    key = robot_key("short")
    short = certificates.issue(
        spec("CN=short", AT - 9 * DAY, AT - timedelta(hours=1)), key.public_key(), key, authority=True
    )
    made = NEXT.but(identity=certificates.Issuer(short.certificate, key), begin=AT - 8 * DAY, number=0)
    assert code(made, Owner(frozenset({keys.fingerprint(key)}))) == "bundle-chain"


def test_a_list_that_keeps_nodes_from_starting() -> None:
    expired = revocations(authority(), 3, last=AT - timedelta(hours=1))
    assert code(NEXT.but(more={"crl.pem": expired})) == "bundle-revoked"
    foreign = revocations(authority("ca2"), 3)
    assert code(NEXT.but(number=0, more={"other.pem": foreign}), of=FIRST.but(number=0)) == "bundle-revoked"


def test_a_certificate_that_its_own_list_revokes() -> None:
    serial = certificates.load(NEXT.certificate).serial_number
    assert code(NEXT.but(more={"crl.pem": revocations(authority(), 3, serial)})) == "bundle-revoked"
    other = NEXT.but(more={"crl.pem": revocations(authority(), 3, serial + 1)})
    assert accept(other.bundle, THERE, Owner(), AT, FILE).files
