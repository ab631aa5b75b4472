# SPDX-License-Identifier: Apache-2.0
"""The published figures of White et al. 2018, on real Cyclone DDS and from the script of the example."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.examples.test_ppac_2018 import EXAMPLE, PUBLISHED, WITHOUT_ERROR, Figures, published_findings, verified

ROW = re.compile(r"^(\S+) +\S+ +(\d+) +(\d+) +(\d+) +(\d+)$", re.MULTILINE)


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Issue certificates by the machine's clock, which vendors use."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(int(time.time())))


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins", "now")
def test_ardent_and_the_papers_amendment(keymint) -> None:
    figures, findings, code = verified(keymint, "amended.xml", "ardent", ("ardent-cyclonedds",))
    assert figures == {"ardent-cyclonedds": PUBLISHED}
    assert findings == {"ardent-cyclonedds": published_findings()}
    assert code == 3


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins", "now")
@pytest.mark.parametrize("distro", ["ardent", "bouncy"])
def test_endpoints_created_in_their_own_partition_are_decided_as_by_the_policy(keymint, distro: str) -> None:
    figures, _, code = verified(keymint, "policy.xml", distro, ("cyclonedds",))
    assert (figures, code) == ({"cyclonedds": WITHOUT_ERROR}, 0)


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclonedds")
def test_one_command_prints_the_figures_and_draws_the_pictures(probe_cache: Path, tmp_path: Path) -> None:
    command = tmp_path / "keymint"
    searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
    command.write_text(f'#!/bin/sh\nPYTHONPATH="{searched}" exec "{sys.executable}" -m keymint "$@"\n')
    command.chmod(0o755)
    environment = {
        **os.environ,
        "KEYMINT": str(command),
        "DISCOVERY": "none",
        "XDG_CACHE_HOME": str(probe_cache),
    }
    environment.pop("SOURCE_DATE_EPOCH", None)
    done = subprocess.run(
        [EXAMPLE / "run", "out"], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    ardent, bouncy = done.stdout.split("== L_tp: ")[1:]
    rows = [(name, Figures(*map(int, counts))) for name, *counts in ROW.findall(ardent)]
    simulated = [("ardent-omg", PUBLISHED), ("ardent-cyclonedds-0.10", PUBLISHED)]
    assert rows == [*simulated, ("ardent-cyclonedds", PUBLISHED), ("ardent-cyclonedds", PUBLISHED)]
    assert "--tier admission" in ardent
    assert {Figures(*map(int, counts)) for _, *counts in ROW.findall(bouncy)} == {WITHOUT_ERROR}
    pictures = ("g_s.svg", "l_fc.svg", "l_tp_ardent/graph-ardent-cyclonedds.svg", "l_tp_bouncy/graph.svg")
    assert all(b"</svg>" in (tmp_path / "out" / picture).read_bytes() for picture in pictures)


def test_the_script_does_not_touch_a_folder_that_it_did_not_create(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    done = subprocess.run(
        [EXAMPLE / "run", "mine"],
        env={**os.environ, "KEYMINT": "true"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, (tmp_path / "mine").is_dir()) == (2, True)
    assert "choose another folder" in done.stderr
