# SPDX-License-Identifier: Apache-2.0
"""What follows from the register: what is in force, which keys are barred, which generations are over."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from keymint.life.register import REASONS, SUPERSEDED, IssuedCertificate, Register, SignedRights

NOW = datetime(2027, 1, 15, tzinfo=UTC)
FIRST = IssuedCertificate("ca", 1, "identity_ca", "talker", 0, NOW - timedelta(9), NOW + timedelta(90), "key 1")
SECOND = replace(FIRST, serial=2, generation=1, key="key 2")
EXPIRED = replace(FIRST, serial=3, not_after=NOW - timedelta(1))
OTHER = replace(FIRST, serial=4, name="listener", key="key 4")
ALL = Register().with_issued([FIRST, SECOND, EXPIRED, OTHER])


def test_what_is_in_force() -> None:
    assert ALL.in_force("talker", NOW) == (FIRST, SECOND)
    assert ALL.with_revoked([FIRST], SUPERSEDED, NOW).in_force("talker", NOW) == (SECOND,)
    assert ALL.in_force("nobody", NOW) == ()


@pytest.mark.parametrize("reason", REASONS)
def test_a_key_is_barred_unless_its_certificate_was_superseded(reason: str) -> None:
    register = ALL.with_revoked([FIRST], reason, NOW)
    assert register.barred("key 1") == ("" if reason == SUPERSEDED else reason)
    assert register.barred("key 2") == register.barred("") == ""
    assert register.is_revoked("ca", 1)
    assert not register.is_revoked("ca", 2)
    assert not register.is_revoked("another ca", 1)


def test_a_subject_is_withdrawn_while_its_last_certificate_is_revoked() -> None:
    register = ALL.with_revoked([FIRST, SECOND, EXPIRED], "retired", NOW)
    assert register.withdrawn("talker") == "retired"
    assert register.withdrawn("listener") == register.withdrawn("nobody") == ""
    assert register.with_issued([replace(SECOND, serial=5, generation=2, key="key 5")]).withdrawn("talker") == ""
    assert ALL.with_revoked([EXPIRED], SUPERSEDED, NOW).withdrawn("talker") == ""


def test_generations_only_rise() -> None:
    assert Register().generation("talker") == 0
    assert ALL.generation("talker") == 1  # issued, not revoked
    assert ALL.with_revoked([FIRST], SUPERSEDED, NOW).generation("talker") == 1
    assert ALL.with_revoked([SECOND], SUPERSEDED, NOW).generation("talker") == 2
    assert ALL.generation("listener") == 0


def test_a_revocation_stays_as_it_is() -> None:
    once = ALL.with_revoked([FIRST], "key-compromise", NOW)
    again = once.with_revoked(once.of("talker"), SUPERSEDED, NOW + timedelta(1))
    assert again.of("talker")[0] == replace(FIRST, revoked=NOW, reason="key-compromise")
    assert once.with_issued([replace(FIRST, rights="new")]).of("talker")[0].reason == "key-compromise"


def test_numbers_only_rise() -> None:
    register = Register().with_number("ca", 7).with_number("ca", 3)
    assert register.numbers == {"ca": 7}


def test_issue_numbers_rise_also_after_the_register_was_lost() -> None:
    first = Register().with_bundle("talker", NOW)
    assert first.bundles == {"talker": int(NOW.timestamp())}
    assert first.with_bundle("talker", NOW).bundles["talker"] == first.bundles["talker"] + 1
    earlier = first.with_bundle("talker", NOW - timedelta(1))
    assert earlier.bundles["talker"] == first.bundles["talker"] + 1
    assert Register().with_bundle("talker", NOW + timedelta(1)).bundles["talker"] > earlier.bundles["talker"]


def test_what_was_signed_stays_when_a_clock_was_ahead() -> None:
    """Documents that have ended are passed over when they are read: a later run with the right clock needs them."""
    begin = datetime(2027, 1, 1, tzinfo=UTC)
    early, late = (
        SignedRights.of("talker", 0, "CN=/talker", begin + timedelta(days=days), bytes([days])) for days in (1, 9)
    )
    register = Register().with_rights([early]).with_rights([late, early])
    assert register.rights == (early, late)
    assert [each.content for each in register.rights] == [b"\1", b"\t"]
