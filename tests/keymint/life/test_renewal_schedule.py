# SPDX-License-Identifier: Apache-2.0
"""What is due, from the dates of documents; the verb is tested in ``tests/keymint/commands/life/test_renew.py``."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.api import Issuance
from keymint.life.renewal_schedule import (
    CERTIFICATE,
    LIST,
    PERMISSIONS,
    authority_ends,
    authority_renewals,
    enclave_terms,
    first_due,
    installed_terms,
    renewal_issuance,
    schedule,
)
from keymint.life.terms import DEFAULT, Term, Threshold
from keymint.stages.package_status import StatusRow
from tests.conftest import NOW
from tests.keymint.stages.sessions import session_of

CLOCK = datetime.fromtimestamp(NOW, UTC)
DAY = timedelta(days=1)
END = CLOCK + 3650 * DAY


def term(what: str = CERTIFICATE, first: int = 0, last: int = 90, authority: str = "ca", *, cut: bool = False) -> Term:
    """A document that begins and ends some days after the clock."""
    return Term(what, CLOCK + first * DAY, CLOCK + last * DAY, Origin("profile"), authority, cut)


def planning(days: float = 0, end: datetime = END, issuer: str = "") -> Any:
    """As much of a session as a schedule reads."""
    authorities = [
        SimpleNamespace(name=name, certificate=SimpleNamespace(issuer=above))
        for name, above in (("root", ""), ("ca", issuer))
    ]
    certificates = {
        name: SimpleNamespace(not_valid_before_utc=CLOCK - 3650 * DAY, not_valid_after_utc=last)
        for name, last in (("root", END), ("ca", end))
    }
    return SimpleNamespace(
        now=CLOCK + days * DAY, profile=SimpleNamespace(authorities=authorities),
        made=lambda key, make, **_: certificates if key[0].__name__ == "_authorities_here" else make(),
    )  # fmt: skip


def test_the_document_that_is_due_first_decides() -> None:
    both = (term(last=90), term(PERMISSIONS, last=30))
    assert first_due(both) == both[1]
    assert both[1].renew_after(DEFAULT) == CLOCK + timedelta(days=19.8)
    for days, due in ((19, ()), (20, ("a",))):
        found = schedule(planning(days), {"a": both}, DEFAULT)
        assert tuple(each.name for each in found.enclaves) == due
        assert bool(found.following) is not bool(due)


def test_what_is_due_next_is_told() -> None:
    found = schedule(planning(), {"a": [term(last=90)], "b": [term(last=60)]}, DEFAULT)
    assert found.following
    assert (found.following.name, found.following.after) == ("b", CLOCK + timedelta(days=39.6))


def test_what_ends_with_its_authority_is_not_due_but_the_authority_is() -> None:
    end = CLOCK + 50 * DAY
    cut = {"a": (term(last=50, cut=True),)}
    found = schedule(planning(49, end), cut, DEFAULT)
    assert (found.enclaves, found.following) == ((), None)
    assert [(each.name, each.end, each.packages, each.issuers) for each in found.authorities] == [
        ("ca", end, ("a",), ())
    ]
    row = StatusRow("a", "installed", "", terms=cut["a"])
    assert (row.renew_after, row.ends_with) == (None, "ca")


def test_an_authority_is_due_as_soon_as_it_would_shorten_a_renewed_certificate() -> None:
    own = {"a": [term(last=90)]}
    # What is renewed begins a day back.
    for days, due in ((0, []), (10, []), (12, ["ca"])):
        found = schedule(planning(days, CLOCK + 100 * DAY), own, DEFAULT)
        assert [each.name for each in found.authorities] == due


def test_an_issuer_that_ends_no_later_is_named() -> None:
    found = schedule(planning(3610, END, issuer="root"), {"a": [term(first=3590, last=3640)]}, DEFAULT)
    assert [(each.name, each.issuers) for each in found.authorities] == [("ca", ("root",))]


def test_an_authority_that_signs_nothing_here_is_not_due() -> None:
    found = schedule(planning(3640), {"a": [term(first=3639, last=3640)]}, Threshold(left=30 * DAY))
    assert [each.name for each in found.authorities] == ["ca"]


def test_a_list_is_due_once_for_all_enclaves() -> None:
    of_both = {name: (term(last=3000), term(LIST, last=30)) for name in ("a", "b")}
    found = schedule(planning(20), of_both, DEFAULT)
    assert [(each.name, each.why and each.why.what) for each in found.lists] == [("ca", LIST)]
    assert found.enclaves == ()
    assert schedule(planning(19), of_both, DEFAULT).lists == ()
    cut = {"a": (term(last=3000), term(LIST, last=30, cut=True))}
    assert schedule(planning(29), cut, DEFAULT).lists == ()


@pytest.mark.parametrize(("cut", "due"), [(False, END - 90 * DAY), (True, CLOCK)])
def test_from_when_on_an_authority_is_due(cut: bool, due: datetime) -> None:
    found = authority_renewals(planning(), (term(last=90, cut=cut), term(LIST, last=3650)))
    assert found == {"ca": due}


class TestWorkspace:
    def test_the_terms_of_an_enclave(self, ws: Path) -> None:
        session = session_of(ws)
        found = enclave_terms(session, "talker")
        assert found
        assert [(each.what, each.issuer, each.is_cut) for each in found] == [
            (CERTIFICATE, "identity_ca", False),
            (PERMISSIONS, "permissions_ca", False),
        ]
        assert {each.last for each in found} == {datetime(2028, 1, 14, tzinfo=UTC)}
        assert list(installed_terms(session, ("talker", "robot1/listener"))) == ["talker", "robot1/listener"]
        assert set(authority_ends(session).values()) == {datetime(2037, 1, 11, tzinfo=UTC)}

    def test_what_is_not_installed_has_no_terms(self, ws: Path) -> None:
        (ws / "install/enclaves/talker/cert.pem").write_text("damaged")
        assert enclave_terms(session_of(ws), "talker") == ()
        assert enclave_terms(session_of(ws), "other") == ()
        assert list(installed_terms(session_of(ws), ("talker", "robot1/listener", "other"))) == ["robot1/listener"]

    def test_a_renewal_begins_the_day_before(self, ws: Path) -> None:
        assert renewal_issuance(session_of(ws), "talker") == Issuance()  # it was made today
        later = renewal_issuance(session_of(ws, NOW + 86_400), "talker")
        assert later == Issuance(renewed=datetime(2027, 1, 15, tzinfo=UTC))
