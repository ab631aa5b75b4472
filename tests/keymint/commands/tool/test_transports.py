# SPDX-License-Identifier: Apache-2.0
"""``keymint transports``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

SIMULATED = {"omg", "cyclonedds-0.10", "fastdds-2.9"}


def test_lists_what_is_usable(keymint: Callable) -> None:
    outcome = keymint("transports", "--json")
    assert outcome.code == 0
    found = {each["name"]: each for each in outcome.document["result"]["transports"]}
    assert {*SIMULATED, "cyclonedds", "fastdds"} <= set(found)
    assert all(found[name]["usable"] and found[name]["tiers"] == ["decision"] for name in SIMULATED)
    for each in found.values():
        assert bool(each["tiers"]) == each["usable"]
        assert each["usable"] or (each["reason"] and each["help"])


def test_says_how_to_install_the_rest(keymint: Callable, tmp_path: Path) -> None:
    outcome = keymint("transports", env={"PATH": str(tmp_path)})
    assert outcome.code == 0
    assert "fastdds: no compiler g++ or c++ (apt-get install g++ libfastrtps-dev libfastcdr-dev" in outcome.out


def test_writes_nothing(keymint: Callable, tmp_path: Path) -> None:
    keymint("transports", env={"XDG_CACHE_HOME": str(tmp_path / "cache")})
    assert list(tmp_path.iterdir()) == []
