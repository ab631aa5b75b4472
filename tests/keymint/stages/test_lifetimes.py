# SPDX-License-Identifier: Apache-2.0
"""What is built and signed though it is not in force, or outlasts its authority: said at each run, with its line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import NOW

AFTER = {"SOURCE_DATE_EPOCH": str(NOW + 2 * 365 * 24 * 3600)}
BEFORE = {"SOURCE_DATE_EPOCH": str(NOW - 365 * 24 * 3600)}
DEFAULTS = "profile/package.defaults"
HELD = re.compile(r"-(expired|not-yet-valid|never-valid|outlives-authority)$")


def extend(workspace: Path, name: str, element: str, date: str) -> int:
    """Give a document of the defaults another date; return the line of the end of its validity."""
    path = workspace / DEFAULTS / name
    text, count = re.subn(f"<{element}>[^<]*</{element}>", f"<{element}>{date}</{element}>", path.read_text())
    assert count == 1
    path.write_text(text)
    return next(number for number, line in enumerate(text.splitlines(), 1) if "<not_after>" in line)


def told(outcome) -> dict[str, tuple[str, int]]:
    """Return the codes about time that a run reports, each with its place."""
    return {
        one["code"]: (one["file"], one["line"]) for one in outcome.document["diagnostics"] if HELD.search(one["code"])
    }


@pytest.mark.parametrize("verb", ["build", "install"])
def test_what_has_expired_is_said_at_each_run(keymint: Callable, provisioned: Path, verb: str):
    lines = {
        kind: next(
            number
            for number, line in enumerate((provisioned / DEFAULTS / name).read_text().splitlines(), 1)
            if "<not_after>" in line
        )
        for kind, name in (("grant", "permissions.xml"), ("certificate", "identities.xml"))
    }
    for force in (False, True, False):
        if force:
            (provisioned / ".keymint/state.json").unlink()
        outcome = keymint(verb, "-w", provisioned, "--json", env=AFTER)
        assert outcome.code == 0, "it is built and signed anyway"
        assert told(outcome) == {
            "grant-expired": ("ws/profile/package.defaults/permissions.xml", lines["grant"]),
            "certificate-expired": ("ws/profile/package.defaults/identities.xml", lines["certificate"]),
        }
    said = keymint(verb, "-w", provisioned, env=AFTER).err
    assert said.count("the grant expired on 2028-01-14T00:00:00Z; now is ") == 1
    assert "[2 packages]" in said


def test_from_wherever_the_user_stands(keymint: Callable, provisioned: Path):
    for cwd, shown in (
        (provisioned.parent, "ws/profile/"),
        (provisioned, "profile/"),
        (provisioned / "src", "../prof"),
    ):
        said = keymint("build", "-w", provisioned, cwd=cwd, env=AFTER).err
        assert f"\n{shown}" in f"\n{said}", said


def test_what_is_not_valid_yet(keymint: Callable, provisioned: Path):
    for verb in ("build", "install"):
        outcome = keymint(verb, "-w", provisioned, "--json", env=BEFORE)
        assert outcome.code == 0
        assert set(told(outcome)) == {"grant-not-yet-valid", "certificate-not-yet-valid", "authority-not-yet-valid"}


def test_a_grant_and_a_certificate_that_outlive_their_authority(keymint: Callable, provisioned: Path):
    line = extend(provisioned, "permissions.xml", "not_after", "2050-01-01T00:00:00")
    extend(provisioned, "identities.xml", "not_after", "2050-01-01T00:00:00")
    for verb in ("build", "install", "build", "install"):
        outcome = keymint(verb, "-w", provisioned, "--json")
        assert outcome.code == 0
        found = told(outcome)
        assert set(found) == {"grant-outlives-authority", "certificate-outlives-authority"}
        assert found["grant-outlives-authority"] == ("ws/profile/package.defaults/permissions.xml", line)
    said = keymint("build", "-w", provisioned).err
    assert "longer than its authority 'permissions_ca', which ends on 2037-01-1" in said
    assert "(ws/profile/profile.defaults/authorities.xml:" in said


def test_provision_says_once_what_two_stages_find(keymint: Callable, provisioned: Path, policy: Path):
    said = keymint("provision", policy, "-w", provisioned, env=AFTER).err
    assert said.count("the grant expired on") == 1
    assert "[2 packages]" in said


def test_what_is_in_force_is_not_mentioned(keymint: Callable, provisioned: Path, policy: Path):
    for arguments in (["build"], ["install"], ["provision", policy]):
        outcome = keymint(*arguments, "-w", provisioned, "--json")
        assert outcome.code == 0
        assert told(outcome) == {}


def test_dates_that_were_edited_by_hand_count_as_they_are_signed(keymint: Callable, provisioned: Path):
    document = provisioned / "build/talker/permissions.xml"
    dates = {"not_before": "2026-01-01T00:00:00", "not_after": "2027-01-10T00:00:00"}
    text = document.read_text()
    for element, date in dates.items():
        text = re.sub(f"<{element}>[^<]*<", f"<{element}>{date}<", text)
    document.write_text(text)
    outcome = keymint("install", "-w", provisioned, "--json")
    assert outcome.code == 0
    found = told(outcome)
    assert set(found) == {"grant-expired"}
    file, line = found["grant-expired"]
    assert file == "ws/build/talker/permissions.xml"
    assert "<grant" in document.read_text().splitlines()[line - 1]
    assert keymint("prove", "-w", provisioned).code == 3
    assert keymint("check", "-w", provisioned).code == 3
    refused = keymint("renew", "talker", "-w", provisioned, "--json")
    assert (refused.code, refused.codes()) == (1, ["hand-edited"])
    assert "'keymint build -f talker -w" in refused.document["diagnostics"][0]["help"]
    assert keymint("renew", "robot1/listener", "-w", provisioned).code == 0
    assert keymint("build", "-f", "talker", "-w", provisioned).code == 0
    assert keymint("renew", "talker", "-w", provisioned).code == 0
    assert keymint("check", "-w", provisioned).code == 0
