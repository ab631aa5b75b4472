# SPDX-License-Identifier: Apache-2.0
"""Gauges of what ends; ``tests/keymint/commands/assure/test_status.py`` reads the whole text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from keymint.output.openmetrics import gauges
from keymint.stages.package_status import package_rows
from tests.conftest import NOW
from tests.keymint.stages.sessions import session_of


def test_an_enclave_that_ends_with_its_authority_has_no_moment_of_renewal(keymint: Callable, ws: Path) -> None:
    late = NOW + 3600 * 86_400
    assert keymint("renew", "talker", cwd=ws, env={"SOURCE_DATE_EPOCH": str(late)}).code == 3
    session = session_of(ws, late)
    found = {each.name: each.values for each in gauges(session, package_rows(session, None))}
    assert [*found["keymint_renew_after_timestamp_seconds"]] == ["/robot1/listener"]
    [due] = set(found["keymint_authority_renew_after_timestamp_seconds"].values())
    assert due <= late


def test_what_is_not_installed_has_no_gauge(ws: Path) -> None:
    (ws / "install/enclaves/talker/cert.pem").unlink()
    (ws / "install/enclaves/talker/key.pem").unlink()
    session = session_of(ws)
    for gauge in gauges(session, package_rows(session, None)):
        assert "/talker" not in gauge.values


def test_a_stale_enclave_is_one(ws: Path) -> None:
    path = ws / "src/talker/permissions.xml"
    path.write_text(path.read_text().replace("/chatter", "/chatter2"))
    session = session_of(ws)
    [stale] = [each for each in gauges(session, package_rows(session, None)) if each.name == "keymint_enclave_stale"]
    assert stale.values == {"/talker": 1, "/robot1/listener": 0}
