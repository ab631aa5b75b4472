# SPDX-License-Identifier: Apache-2.0
"""Lengths of time on the command line, and ``--valid-for``, which sets those of certificates and grants."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click
import pytest

from keymint.command_line import options
from keymint.pki import certificates
from tests.conftest import NOW, snapshot

CLOCK = datetime.fromtimestamp(NOW, UTC)
DAY = CLOCK.replace(hour=0, minute=0, second=0)


@pytest.mark.parametrize(
    ("text", "length", "duration"),
    [
        ("12h", timedelta(hours=12), "PT12H"),
        ("30d", timedelta(days=30), "P30D"),
        ("4w", timedelta(weeks=4), "P4W"),
        ("2y", timedelta(days=730), "P2Y"),
        ("P90D", timedelta(days=90), "P90D"),
        ("P1Y6M", timedelta(days=545), "P1Y6M"),
        ("P1DT6H", timedelta(hours=30), "P1DT6H"),
    ],
)
def test_a_length_of_time(text: str, length: timedelta, duration: str) -> None:
    assert options.period(text) == length
    assert options.iso_validity(text) == duration


@pytest.mark.parametrize("text", ["", "12", "h", "-3d", "3m", "1.5d", "P", "PT", "P1DT", "p90d", "201y", "90 d", "٣d"])
def test_no_length_of_time(text: str) -> None:
    for parse in (options.period, options.iso_validity):
        with pytest.raises(click.BadParameter):
            parse(text)


@pytest.mark.parametrize("text", ["0d", "0h", "P0D"])
def test_a_validity_of_no_time(text: str) -> None:
    assert options.period(text) == timedelta()
    with pytest.raises(click.BadParameter, match="shorter than an hour"):
        options.iso_validity(text)


@pytest.mark.parametrize(
    ("option", "begin", "length"),
    [
        ("90d", DAY - timedelta(days=1), timedelta(days=90)),
        ("P2Y", DAY - timedelta(days=1), timedelta(days=731)),  # 2028 is a leap year
        ("20h", CLOCK - timedelta(hours=2), timedelta(hours=20)),
    ],
)
def test_certificates_and_grants_have_this_length(
    keymint: Callable, policy: Path, tmp_path: Path, option: str, begin: datetime, length: timedelta
) -> None:
    made = keymint("provision", policy, "-w", "ws", "--valid-for", option)
    assert made.code == 0, made.err
    ws = tmp_path / "ws"
    certificate = certificates.load((ws / "install/enclaves/talker/cert.pem").read_bytes())
    assert certificate.not_valid_before_utc == begin
    assert certificate.not_valid_after_utc == begin + length
    permissions = (ws / "install/enclaves/talker/permissions.xml").read_text()
    assert f"{begin:<not_before>%Y-%m-%dT%H:%M:%S}" in permissions
    assert f"{begin + length:<not_after>%Y-%m-%dT%H:%M:%S}" in permissions
    before = snapshot(ws)
    assert keymint("provision", policy, "-w", "ws", "--valid-for", option).code == 0
    assert snapshot(ws) == before


def test_an_existing_workspace_keeps_its_length(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    assert keymint("init", "ws", "--valid-for", "90d").code == 0
    before = snapshot(tmp_path / "ws")
    outcome = keymint("init", "ws", "--valid-for", "30d")
    assert outcome.code == 1
    assert "has valid-for 'P90D', so --valid-for P30D cannot take effect" in outcome.err
    assert "package.defaults/identities.xml" in outcome.err
    assert snapshot(tmp_path / "ws") == before
    assert keymint("init", "ws", "--valid-for", "P90D").code == 0


def test_without_the_option_the_files_are_those_of_before(keymint: Callable, tmp_path: Path) -> None:
    assert keymint("init", "ws").code == 0
    for name in ("identities", "permissions"):
        text = (tmp_path / f"ws/profile/package.defaults/{name}.xml").read_text()
        assert "<not_before>2027-01-14T00:00:00</not_before>\n    <not_after>2028-01-14T00:00:00</not_after>" in text
    assert keymint("init", "ws", "--valid-for", "365d").code == 0


class TestCreate:
    @pytest.fixture
    def created(self, keymint: Callable, policy: Path, tmp_path: Path) -> Path:
        """A workspace with source packages that are not built yet."""
        assert keymint("init", "ws", "--policy", policy).code == 0
        assert keymint("create", "--all", "-w", "ws").code == 0
        return tmp_path / "ws"

    def test_the_package_has_a_length_of_its_own(self, keymint: Callable, created: Path) -> None:
        assert keymint("create", "talker", "--valid-for", "90d", cwd=created).code == 0
        for verb in ("build", "install", "check", "prove"):
            outcome = keymint(verb, cwd=created)
            assert outcome.code == 0, outcome.err
        lengths = {}
        for name in ("talker", "robot1/listener"):
            certificate = certificates.load((created / "install/enclaves" / name / "cert.pem").read_bytes())
            lengths[name] = certificate.not_valid_after_utc - certificate.not_valid_before_utc
            text = (created / "install/enclaves" / name / "permissions.xml").read_text()
            assert f"{certificate.not_valid_after_utc:%Y-%m-%d}" in text
        assert lengths == {"talker": timedelta(days=90), "robot1/listener": timedelta(days=365)}

    def test_again_changes_nothing_even_later(self, keymint: Callable, created: Path) -> None:
        assert keymint("create", "talker", "--valid-for", "90d", cwd=created).code == 0
        before = snapshot(created / "src")
        later = {"SOURCE_DATE_EPOCH": str(NOW + 10 * 86_400)}
        assert keymint("create", "talker", "--valid-for", "90d", cwd=created, env=later).code == 0
        assert keymint("create", "--all", cwd=created, env=later).code == 0
        assert snapshot(created / "src") == before

    def test_a_new_rule_keeps_the_length(self, keymint: Callable, created: Path, policy: Path) -> None:
        assert keymint("create", "talker", "--valid-for", "90d", cwd=created).code == 0
        policy.write_text(policy.read_text().replace("/chatter", "/chatter2"))
        assert keymint("create", "talker", cwd=created).code == 0
        text = (created / "src/talker/permissions.xml").read_text()
        assert "/chatter2" in text
        assert "<duration>P90D</duration>" in text

    @pytest.mark.parametrize("document", ["identities.xml", "permissions.xml"])
    def test_what_its_owner_edited_is_kept(self, keymint: Callable, created: Path, document: str) -> None:
        path = created / "src/talker" / document
        path.write_text(path.read_text().replace("?>", "?>\n<!-- mine -->", 1))
        before = snapshot(created)
        outcome = keymint("create", "talker", "--valid-for", "90d", cwd=created)
        assert outcome.code == 1
        assert f"src/talker/{document}: error: was edited by hand" in outcome.err
        assert "<duration>P90D</duration>" in outcome.err
        assert snapshot(created) == before

    def test_another_length_is_not_replaced(self, keymint: Callable, created: Path) -> None:
        assert keymint("create", "talker", "--valid-for", "90d", cwd=created).code == 0
        before = snapshot(created)
        assert keymint("create", "talker", "--valid-for", "30d", cwd=created).code == 1
        assert snapshot(created) == before

    def test_a_grant_of_zenoh_has_no_dates(self, keymint: Callable, policy: Path, tmp_path: Path) -> None:
        assert keymint("init", "z", "--policy", policy, "--transport", "zenoh").code == 0
        assert keymint("create", "talker", "--valid-for", "90d", "-w", "z").code == 0
        assert "validity" not in re.sub(
            "<!--.*?-->", "", (tmp_path / "z/src/talker/permissions.xml").read_text(), flags=re.DOTALL
        )
        assert "<duration>P90D" in (tmp_path / "z/src/talker/identities.xml").read_text()
