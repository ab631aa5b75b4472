# SPDX-License-Identifier: Apache-2.0
"""The example that ``make demo-zenoh`` runs: installed files as they are, on the port that they name."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from keymint_ros2_zenoh.vendors.loopback import free_port

from tests.conftest import CHECKOUT

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

DEMO = CHECKOUT / "examples/zenoh/talker_listener.py"


@pytest.fixture
def install(keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The talker/listener example, installed for a router on a free port."""
    monkeypatch.delenv("SOURCE_DATE_EPOCH")  # Zenoh uses the clock of the machine
    policy = CHECKOUT / "examples/talker_listener"
    assert keymint("init", "ws", "--policy", policy, "--transport", "zenoh").code == 0
    defaults = tmp_path / "ws/profile/package.defaults/zenoh.xml"
    changed, count = re.subn("<port>[0-9]+</port>", f"<port>{free_port()}</port>", defaults.read_text())
    assert count == 1
    defaults.write_text(changed)
    for verb in (("create", "--all"), ("build",), ("install",)):
        assert keymint(*verb, "-w", "ws").code == 0
    return tmp_path / "ws/install"


def demo(install: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(DEMO), str(install)], capture_output=True, text=True, check=False, timeout=120
    )


def test_the_listener_hears_the_talker_and_nobody_else(install: Path) -> None:
    done = demo(install)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1:] == [
        "/talker    publishes on /chatter:  delivered to /listener",
        "/listener  publishes on /chatter:  not delivered: it has no right to",
        "stranger   without a certificate:  refused",
    ]


def test_a_router_without_access_control_would_be_seen(install: Path) -> None:
    router = install / "zenoh/router.json5"
    text, count = re.subn(r'("?enabled"?: )true(,\s+"?default_permission)', r"\1false\2", router.read_text())
    assert count == 1
    router.write_text(text)
    done = demo(install)
    assert done.returncode == 1
    assert "/listener  publishes on /chatter:  DELIVERED" in done.stdout
