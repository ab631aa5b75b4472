# SPDX-License-Identifier: Apache-2.0
"""Ten years of a fleet: no robot ever has an expired or torn keystore, and no stolen file gives a right that was taken.

The clock is simulated (``SOURCE_DATE_EPOCH``); in the last tests it is that of the system (libfaketime). With
``KEYMINT_FULL=1`` the fleet is larger, the rounds are shorter, and 50 certificates are revoked.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from keymint.pki import certificates
from tests.conftest import CHECKOUT
from tests.effort import FULL, tries
from tests.robustness.simulated_fleet import DAY, START, Fleet

YEARS = 10
ROUND = tries(55, 15) * DAY
NAMES = tuple(f"robot{number}" for number in range(tries(3, 5)))
REVOCATIONS = tries(8, 50)
VALID_FOR = "100d" if FULL else "1y"
FAKETIME = Path("/usr/lib") / f"{os.uname().machine}-linux-gnu" / "faketime/libfaketime.so.1"


def test_ten_years_of_a_fleet(keymint: Callable, memory: Path) -> None:
    chance = random.Random(7)
    fleet = Fleet(keymint, memory, NAMES, VALID_FOR, chance)
    rounds = int(YEARS * 365 * DAY / ROUND)
    revoked_in = sorted(chance.sample(range(1, rounds - 3), REVOCATIONS))
    rollover = rounds // 2
    late: set[str] = set()
    for number in range(1, rounds + 1):
        fleet.now = START + number * ROUND
        for name in sorted(fleet.withdrawn):
            fleet.restore(name)
        together = number == rollover
        if together:
            _replace_identity_authority(fleet)
        together |= fleet.renew()
        if number in revoked_in:
            _take_away(fleet, NAMES[number % len(NAMES)], revoked_in.index(number))
        fleet.run("check", "-q")
        # Before anything is deployed: the robots have what they got a round ago, some of them two.
        problems = [problem for name in NAMES for problem in fleet.problems(name)]
        late = set() if together else {name for name in NAMES if name not in late and chance.random() < 0.2}
        for name in NAMES:
            if name not in late:
                fleet.deploy(name)
        problems += [problem for name in NAMES for problem in fleet.problems(name)]
        assert problems == []
        up_to_date = [name for name in NAMES if name not in late and name not in fleet.withdrawn]
        if up_to_date and (number % 4 == 0 or number in revoked_in):
            assert [theft for name in NAMES for theft in fleet.thefts(name, up_to_date[0], tries(3, 4))] == []
    assert fleet.revocations >= REVOCATIONS
    assert all(len(fleet.issued[name]) > YEARS for name in NAMES)


def _take_away(fleet: Fleet, name: str, turn: int) -> None:
    """Revoke the certificate of a subject, in one of the ways that there are."""
    if turn % 3 == 0:
        fleet.revoke(name, "key-compromise")
    elif turn % 3 == 1:
        fleet.revoke(name, "superseded")
    else:
        before = fleet.run("issued", "--revoked", "--json").document["result"]["certificates"]
        fleet.rights[name] = {"scan"} if len(fleet.rights[name]) > 1 else {"odom", "image"}
        fleet.provision()
        after = fleet.run("issued", "--revoked", "--json").document["result"]["certificates"]
        assert len(after) > len(before)
        fleet.revocations += len(after) - len(before)


def _replace_identity_authority(fleet: Fleet) -> None:
    """Give the identity authority a new key: all robots change at one restart."""
    path = fleet.ws / "public/identity_ca.cert.pem"
    before = path.read_bytes()
    fleet.run("authority", "replace", "identity_ca")
    assert (fleet.ws / "install.next/enclaves").is_dir()
    fleet.run("authority", "replace", "identity_ca", "--phase", "end")
    assert path.read_bytes() != before
    assert [path for path in (fleet.ws / "install.next").rglob("*") if path.is_file()] == []


def test_the_simulation_would_find_an_expired_robot(keymint: Callable, memory: Path) -> None:
    fleet = Fleet(keymint, memory, NAMES[:1], "1y", random.Random(1))
    fleet.now = START + 364 * DAY
    assert [*fleet.problems(NAMES[0])] != []


def test_the_simulation_would_find_old_rights(keymint: Callable, memory: Path) -> None:
    fleet = Fleet(keymint, memory, NAMES[:2], "1y", random.Random(1))
    fleet.rights[NAMES[0]] = {"scan"}
    policy = memory / "policy.xml"
    policy.write_text(policy.read_text().replace("/odom", "/gone", 1))
    fleet.run("provision", policy, "-q")  # without --revoke-superseded
    for name in fleet.names:
        fleet.deploy(name)
    assert [*fleet.thefts(NAMES[0], NAMES[1], 3)] != []


@pytest.mark.skipif(not FAKETIME.exists(), reason="no libfaketime: .ci/setup-vendors.sh installs it")
class TestClockOfTheSystem:
    """The clock itself is moved, for Keymint and for openssl."""

    def at(self, moment: datetime, *command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
        environment: Mapping[str, str] = {
            **{name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"},
            "LD_PRELOAD": str(FAKETIME),
            "FAKETIME": f"@{moment:%Y-%m-%d %H:%M:%S}",
            "TZ": "UTC",
            "NO_FAKE_STAT": "1",
        }
        return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)

    def test_renewal_by_the_clock(self, tmp_path: Path) -> None:
        keymint = Path(sys.executable).parent / "keymint"
        begin = datetime(2031, 5, 6, 7, 8, 9, tzinfo=UTC)
        policy = CHECKOUT / "examples/talker_listener/talker_listener.xml"
        made = self.at(
            begin, keymint, "provision", policy, "-w", "ws", "--valid-for", "90d", "--no-prove", cwd=tmp_path
        )
        assert made.returncode == 0, made.stderr
        enclave = tmp_path / "ws/install/enclaves/talker"
        first = (enclave / "cert.pem").read_bytes()
        assert certificates.load(first).not_valid_before_utc == datetime(2031, 5, 5, tzinfo=UTC)
        for days, expected in ((30, False), (70, True)):
            done = self.at(begin + timedelta(days=days), keymint, "renew", "-w", "ws", cwd=tmp_path)
            assert (done.returncode, done.stderr) == (0, "")
            assert ((enclave / "cert.pem").read_bytes() != first) is expected
        (tmp_path / "old.pem").write_bytes(first)
        ca = enclave / "identity_ca.cert.pem"
        later = begin + timedelta(days=95)
        old = self.at(later, "openssl", "verify", "-CAfile", ca, "old.pem", cwd=tmp_path)
        new = self.at(later, "openssl", "verify", "-CAfile", ca, enclave / "cert.pem", cwd=tmp_path)
        assert ("certificate has expired" in old.stderr, new.returncode) == (True, 0)
        assert self.at(later, keymint, "check", "-w", "ws", cwd=tmp_path).returncode == 0
