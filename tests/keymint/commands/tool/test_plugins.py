# SPDX-License-Identifier: Apache-2.0
"""``keymint plugins`` lists the profiles that ROS packages ship."""

from __future__ import annotations

from pathlib import Path

from tests.keymint.commands.test_json import held
from tests.ros_packages import fragment, ship, topic

FILES = {"controller.xml": fragment(topic("/cmd_vel")), "parts/a.xml": topic("/a"), "notes.txt": ""}


def test_what_packages_ship(keymint, tmp_path: Path) -> None:
    folder = ship(tmp_path / "over", FILES)
    hidden = ship(tmp_path / "under", FILES)
    ship(tmp_path / "under", {}, "another")
    ship(tmp_path / "under", FILES, "no.package")
    env = {"AMENT_PREFIX_PATH": f"{tmp_path}/over:relative::{tmp_path}/none:{tmp_path}/under"}
    outcome = keymint("plugins", env=env)
    assert outcome.code == 0
    assert "warning: AMENT_PREFIX_PATH has the relative path 'relative'" in outcome.err
    table = outcome.out.rpartition("\n\n")[2].splitlines()
    assert [" ".join(line.split()) for line in table] == [
        "PACKAGE SHIPS HIDDEN BY FROM",
        "another - under/share/another/keymint/comarmor.d",
        "nav2_bringup controller.xml parts/a.xml - over/share/nav2_bringup/keymint/comarmor.d",
        f"nav2_bringup controller.xml parts/a.xml {tmp_path}/over under/share/nav2_bringup/keymint/comarmor.d",
    ]
    result = held(keymint("plugins", "--json", env=env))["result"]["packages"]
    assert [(each["name"], each["folder"], each["files"], each["hidden_by"]) for each in result[1:]] == [
        ("nav2_bringup", str(folder), ["controller.xml", "parts/a.xml"], None),
        ("nav2_bringup", str(hidden), ["controller.xml", "parts/a.xml"], str(tmp_path / "over")),
    ]


def test_without_any(keymint) -> None:
    assert "PACKAGE" not in keymint("plugins").out
    assert held(keymint("plugins", "--json"))["result"]["packages"] == []
