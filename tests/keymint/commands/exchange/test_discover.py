# SPDX-License-Identifier: Apache-2.0
"""``keymint discover`` from captures; from running systems: ``tests/real/test_discover.py``."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
from keymint_ros2_dds.discovery import graph_source

from keymint.api.graph_json import load
from tests.conftest import CHECKOUT
from tests.plugins.keymint_ros2_dds.discovery.admin_console_file import participant, system

SCHEMA = json.loads((CHECKOUT / "schemas/keymint/graph.schema.json").read_text())
READ = ("describe_parameters", "get_parameters", "get_parameter_types", "list_parameters")
TALKER = participant("talker", [("publish", "rt/chatter", "std_msgs::msg::dds_::String_", [])])
READER = participant(
    "",
    [
        edge
        for name in READ
        for edge in (
            ("publish", f"rq/talker/{name}Request", "", []),
            ("subscribe", f"rr/talker/{name}Reply", "", []),
        )
    ],
    "a1, 2, 3, 1c1",
)


@pytest.fixture
def capture(tmp_path: Path) -> str:
    (tmp_path / "c.xml").write_bytes(system(TALKER, READER))
    return "c.xml"


def permissions(content: bytes | str) -> list[tuple[str, str]]:
    document = json.loads(content)
    jsonschema.validate(document, SCHEMA)
    return [(edge["permission"], edge["object"]) for edge in document["edges"]]


def test_to_standard_output(keymint, capture: str) -> None:
    outcome = keymint("discover", "--from", capture)
    assert outcome.code == 0
    assert permissions(outcome.out) == [("ros_read", "/talker"), ("ros_publish", "/chatter")]
    assert "warning: participant 000000a1" in outcome.err


def test_to_a_file(keymint, capture: str, tmp_path: Path) -> None:
    outcome = keymint("discover", "--from", capture, "-o", "g.json", "--subject", "000000a1=/tool/reader", "--no-fold")
    assert (outcome.code, outcome.err) == (0, "")
    assert "2 subjects, 5 edges, objects: 4 ros_service, 1 ros_topic" in outcome.out
    assert load((tmp_path / "g.json").read_bytes(), "g.json").subjects == ("/talker", "/tool/reader")
    again = keymint("discover", "--from", capture, "-o", "g.json", "--subject", "000000a1=/tool/reader", "--no-fold")
    assert "g.json is up to date" in again.out


def test_captures_add_up(keymint, tmp_path: Path) -> None:
    (tmp_path / "1.xml").write_bytes(system(TALKER))
    (tmp_path / "2.xml").write_bytes(system(READER))
    name = ["--subject", "000000a1=/reader"]
    assert keymint("discover", "--from", "1.xml", "--append", "g.json").code == 0
    assert keymint("discover", "--from", "2.xml", "--append", "g.json", *name).code == 0
    both = keymint("discover", "--from", "1.xml", "--from", "2.xml", *name).out
    assert (tmp_path / "g.json").read_text() == both
    assert [found for found, _ in permissions(both)] == ["ros_read", "ros_publish"]
    apart = permissions(keymint("discover", "--from", "g.json", "--no-fold").out)
    assert [found for found, _ in apart] == ["ros_call"] * 4 + ["ros_publish"]


def test_names_that_change_between_two_records_are_noted(keymint, tmp_path: Path) -> None:
    for name, topic in (("1", "rt/driver_8812/status"), ("2", "rt/driver_9120/status")):
        (tmp_path / f"{name}.xml").write_bytes(system(participant("talker", [("publish", topic, "", [])])))
    assert keymint("discover", "--from", "1.xml", "--append", "g.json").err == ""
    outcome = keymint("discover", "--from", "2.xml", "--append", "g.json")
    assert outcome.code == 0
    assert outcome.err.startswith("note: /driver_8812/status in one record, /driver_9120/status in another: ")
    assert "then write /driver_*/status in the policy" in outcome.err
    assert [name for _, name in permissions((tmp_path / "g.json").read_bytes())] == [
        "/driver_8812/status",
        "/driver_9120/status",
    ]


def test_append_leaves_the_old_graph_when_the_result_goes_elsewhere(keymint, capture: str, tmp_path: Path) -> None:
    keymint("discover", "--from", capture, "-o", "g.json", "-q")
    before = (tmp_path / "g.json").read_bytes()
    (tmp_path / "2.xml").write_bytes(system(participant("other", [("subscribe", "rt/chatter", "", [])])))
    assert keymint("discover", "--from", "2.xml", "--append", "g.json", "-o", "h.json").code == 0
    assert (tmp_path / "g.json").read_bytes() == before
    assert ("ros_subscribe", "/chatter") in permissions((tmp_path / "h.json").read_bytes())


def test_dry_run_writes_nothing(keymint, capture: str, tmp_path: Path) -> None:
    outcome = keymint("discover", "--from", capture, "-o", "g.json", "--dry-run")
    assert "would be written" in outcome.out
    assert not (tmp_path / "g.json").exists()


def test_as_json(keymint, capture: str) -> None:
    result = keymint("discover", "--from", capture, "--json").document["result"]
    assert (result["edges"], result["file"], result["written"]) == (2, None, [])
    assert permissions(json.dumps(result["graph"]))
    result = keymint("discover", "--from", capture, "--json", "-o", "g.json").document["result"]
    assert (result["graph"], result["file"], result["written"]) == (None, "g.json", ["g.json"])


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--from", "missing.xml"], 1, "missing.xml: error: no such file"),
        (["--from", "."], 1, "not a regular file"),
        (["--from", "junk"], 1, "neither a graph nor a known capture"),
        (["--from", "c.xml", "--domain", "3"], 2, "--domain cannot be combined with --from"),
        (["--from", "c.xml", "--subject", "x"], 2, "ID=NAME"),
        (["--from", "c.xml", "--subject", "x=/a"], 2, "'x' is not a GUID"),
        (["--from", "c.xml", "--source", "keymint_ros2_dd"], 2, "did you mean 'keymint_ros2_dds'?"),
        (["--from", "c.xml", "-o", "link.json"], 1, "symbolic link"),
        (["--from", "c.xml", "-o", "junk/g.json"], 1, "junk"),
        (["--domain", "300"], 2, "300"),
    ],
)
def test_what_is_refused(keymint, capture: str, tmp_path: Path, arguments: list[str], code: int, words: str) -> None:
    (tmp_path / "junk").write_text("junk")
    (tmp_path / "link.json").symlink_to("elsewhere.json")
    outcome = keymint("discover", *arguments)
    assert outcome.code == code
    assert words in outcome.err
    assert not (tmp_path / "elsewhere.json").exists()


def test_a_domain_id_that_is_none(keymint) -> None:
    outcome = keymint("discover", env={"ROS_DOMAIN_ID": "x"})
    if graph_source.usable().usable:
        assert (outcome.code, "ROS_DOMAIN_ID is 'x'" in outcome.err) == (2, True)
    else:
        assert (outcome.code, "libddsc" in outcome.err) == (1, True)
