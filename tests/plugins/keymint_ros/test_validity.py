# SPDX-License-Identifier: Apache-2.0
"""Periods of validity: dates and durations."""

from __future__ import annotations

import pytest

from .workspaces import Workspace, diagnostic_of

_DEFAULTS = "profile/profile.defaults/authorities.xml"
_PERIOD = "<not_after>2036-11-17T00:00:00</not_after>"


def test_a_date_without_zone_is_in_utc(workspace: Workspace) -> None:
    workspace = workspace.edit(_DEFAULTS, _PERIOD, "<not_after>2036-11-17T00:00:00.75Z</not_after>")
    validity = workspace.load_profile().authorities[0].certificate.validity
    assert validity.not_after.isoformat() == "2036-11-17T00:00:00+00:00"
    assert validity.not_before.tzinfo is not None


@pytest.mark.parametrize(
    ("end", "code", "hint"),
    [
        ("<not_after>2020-01-01T00:00:00</not_after>", "validity-order", "end after"),
        ("<not_after>12026-01-01T00:00:00</not_after>", "date-invalid", "which means UTC"),
        ("<not_after>9999-12-31T23:59:59-14:00</not_after>", "date-invalid", "which means UTC"),
        ("<not_after>1940-12-31T23:59:59</not_after>", "date-invalid", "which means UTC"),
        ("<not_after>tomorrow</not_after>", "schema", ""),
        ("<duration>1 year</duration>", "duration-invalid", "P1Y"),
        ("<duration>-P1Y</duration>", "duration-invalid", "P1Y"),
        ("<duration>P9999Y</duration>", "duration-invalid", "P1Y"),
        (f"<duration>P{'9' * 60}D</duration>", "duration-invalid", "P1Y"),
        ("<duration>P0.5Y</duration>", "duration-invalid", "P1Y"),
        ("<duration>PT0S</duration>", "validity-order", "end after"),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(workspace: Workspace, end: str, code: str, hint: str) -> None:
    edited = workspace.edit(_DEFAULTS, _PERIOD, end)
    diagnostic = diagnostic_of(edited.load_profile, f"/ws/{_DEFAULTS}")
    assert diagnostic.code == code
    assert hint in diagnostic.help
