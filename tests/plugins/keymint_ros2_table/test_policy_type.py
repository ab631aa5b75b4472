# SPDX-License-Identifier: Apache-2.0
"""A table as the policy of a workspace, through all stages."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.plugins.keymint_ros2_table.tables import csv_file, database

BEFORE = "CREATE TABLE robot (name TEXT); INSERT INTO robot VALUES ('r1'), ('r2')"
VIEW = (
    "SELECT '*', 'include', '', 'common/node.xml', '', 0, '' UNION ALL"
    " SELECT '/' || name, 'ros_topic', 'ros_publish', '/' || name || '/x', 'ALLOW', 0, 'robot ' || name FROM robot"
)


@pytest.fixture
def fleet(keymint, tmp_path: Path) -> Iterator[sqlite3.Connection]:
    """The database of a provisioned workspace."""
    path = database(tmp_path, VIEW, BEFORE)
    outcome = keymint("provision", path.name, "-w", "ws")
    assert (outcome.code, outcome.err) == (0, "")
    with closing(sqlite3.connect(path)) as opened:
        yield opened


def test_the_documents_are_proven_and_come_from_the_rows(keymint, fleet: sqlite3.Connection) -> None:
    assert keymint("check", "-w", "ws").code == 0
    assert keymint("prove", "-w", "ws").code == 0
    assert keymint("verify", "-w", "ws", "-i", "omg").code == 0
    assert "(robot r1 [rules.db])" in keymint("why", "/r1", "ros_publish", "/r1/x", "-w", "ws", "-i", "omg").out
    assert keymint("provision", "rules.db", "-w", "ws").out.startswith("nothing to do")


def test_only_what_concerns_a_change_is_made_again(keymint, fleet: sqlite3.Connection) -> None:
    with fleet:
        fleet.execute("DELETE FROM robot")
        fleet.executemany("INSERT INTO robot VALUES (?)", [("r0",), ("r1",), ("r2",)])
    document = keymint("provision", "rules.db", "-w", "ws", "--json").document
    assert {step["package"] for step in document["steps"] if step["action"] != "unchanged"} == {"r0"}


def test_a_database_in_use_stops_the_run_before_anything_is_written(keymint, fleet, tmp_path: Path) -> None:
    fleet.execute("BEGIN IMMEDIATE")
    fleet.execute("INSERT INTO robot VALUES ('r3')")
    (tmp_path / "rules.db-journal").write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7")
    outcome = keymint("provision", "rules.db", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["table-in-use"])
    fleet.rollback()


def test_a_workspace_with_another_type_of_policy_says_what_to_do(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    csv_file(tmp_path, "/a,ros_topic,ros_publish,/x,ALLOW,,")
    outcome = keymint("provision", "rules.csv", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["policy-foreign"])
    (found,) = outcome.document["diagnostics"]
    marker = "ws/profile/keymint_profile.xml"
    assert found["help"].startswith(f"write <policy_type>keymint_ros2_table</policy_type> into {marker}")
    text = (tmp_path / marker).read_text()
    (tmp_path / marker).write_text(
        text.replace("keymint_ros2_comarmor</policy_type>", "keymint_ros2_table</policy_type>")
    )
    assert keymint("provision", "rules.csv", "-w", "ws").code == 0


def test_verbs_about_policies_read_a_table(keymint, tmp_path: Path) -> None:
    csv_file(tmp_path, "/a,ros_topic,ros_publish,/x,ALLOW,,t 1")
    database(tmp_path, "SELECT '/a', 'ros_topic', 'ros_publish', '/y', 'ALLOW', 0, 't 2'")
    (tmp_path / "rules.csv.test.xml").write_text(
        '<tests><test name="t"><allow subject="/a" permission="publish" object="/x"/></test></tests>'
    )
    assert keymint("lint", "rules.csv").code == 0
    assert keymint("test", "rules.csv").code == 0
    assert keymint("graph", "rules.csv", "-o", "x.svg").code == 0
    diff = keymint("diff", "rules.csv", "rules.db")
    assert "+ ros_publish /y (t 2 [rules.db])" in diff.out
    assert "- ros_publish /x (t 1 [rules.csv]:2)" in diff.out
    assert keymint("init", "new", "--policy", "rules.csv").code == 0
    assert "<policy_type>keymint_ros2_table</policy_type>" in (tmp_path / "new/profile/keymint_profile.xml").read_text()


def test_verbs_that_need_another_type_say_what_it_is(keymint, tmp_path: Path) -> None:
    csv_file(tmp_path, "/a,ros_topic,ros_publish,/x,ALLOW,,")
    (tmp_path / "graph.json").write_text(
        '{"format": "keymint-graph", "version": 1, "subjects": ["/a"], "types": [],'
        ' "edges": [{"subject": "/a", "permission": "ros_publish", "object": "/x", "domain": 0}]}'
    )
    outcome = keymint("learn", "graph.json", "--policy", "rules.csv")
    assert outcome.code == 1
    assert outcome.err.startswith("rules.csv: error: this is a table of rules (")


def test_a_source_cannot_hide_a_rule_as_one_of_the_library(keymint, tmp_path: Path) -> None:
    keymint("init", "ws")
    node = "ws/profile/comarmor.d/common/node.xml"
    csv_file(tmp_path, f"/a,ros_topic,ros_publish,/x,ALLOW,,{node}:3", f"/b,ros_topic,ros_subscribe,/x,ALLOW,,{node}:3")
    assert keymint("query", "rules.csv", "isolated", "/a", "/b").code == 3


def test_the_file_of_a_row_with_a_source_is_the_table(keymint, tmp_path: Path) -> None:
    csv_file(
        tmp_path, "/a,ros_topic,ros_publish,/x,ALLOW,,ticket 4711", "/a,ros_topic,ros_publish,/x,ALLOW,,/etc/passwd"
    )
    outcome = keymint("lint", "rules.csv", "--sarif", "found.sarif", "--json")
    found = [each for each in outcome.document["diagnostics"] if each["code"] != "node-cannot-start"]
    assert {(each["file"], each["source"]) for each in found} <= {
        ("rules.csv", "ticket 4711"),
        ("rules.csv", "/etc/passwd"),
    }
    assert found
    results = json.loads((tmp_path / "found.sarif").read_text())["runs"][0]["results"]
    locations = [each["locations"][0] for each in results]
    assert {each["physicalLocation"]["artifactLocation"]["uri"] for each in locations} == {"rules.csv"}
    assert {each["properties"]["source"] for each in locations} <= {"ticket 4711", "/etc/passwd"}
