# SPDX-License-Identifier: Apache-2.0
"""Two build types in one workspace: each transport is asked about what its own build type built."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from lxml import etree

from keymint.api import plugin_loader
from keymint.run import run
from tests.keymint import board

DDS = ("-i", "omg")
BOTH = ("-i", "omg", "-i", "board-1")
RIGHTS = "install/board/rights.txt"


@pytest.fixture
def two(keymint: Callable, policy: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A workspace whose talker has DDS and the board, and whose listener has DDS."""
    monkeypatch.setattr(run, "entries_in", lambda metadata: (*plugin_loader.entries_in(metadata), *board.ENTRIES))
    made = keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "board", "--no-prove")
    assert made.code == 0, made.err
    manifest = tmp_path / "ws/src/robot1/listener/keymint_package.xml"
    text, count = re.subn(rf" *<build_type>{board.NAME}</build_type>\n", "", manifest.read_text())
    assert count == 1
    manifest.write_text(text)
    install(keymint)
    return tmp_path / "ws"


def install(keymint: Callable) -> None:
    for verb in ("build", "install"):
        outcome = keymint(verb, "-w", "ws", *(["--no-prove"] if verb == "install" else []))
        assert outcome.code == 0, outcome.err


def by_name(document: dict) -> dict[str, dict]:
    return {each["name"]: each for each in document["result"]["transports"]}


def test_every_transport_is_asked_about_the_enclaves_and_kinds_of_its_build_type(keymint: Callable, two: Path) -> None:
    outcome = keymint("verify", "-w", two, *BOTH, "--json")
    assert outcome.code == 0, outcome.err
    found = by_name(outcome.document)
    assert list(found) == ["omg", "board-1"]
    counts = {name: sum(each["confusion"].values()) for name, each in found.items()}
    alone = {
        name: sum(by_name(keymint("verify", "-w", two, "-i", name, "--json").document)[name]["confusion"].values())
        for name in found
    }
    assert counts == alone
    assert 0 < counts["board-1"] < counts["omg"]
    assert outcome.document["result"]["subjects"] == ["/robot1/listener", "/talker"]
    assert outcome.document["result"]["edges"] == sum(counts.values())
    only = keymint("verify", "-w", two, "-i", "board-1", "--json").document["result"]
    assert only["subjects"] == ["/talker"]


def test_all_usable_transports_of_the_build_types_are_asked_without_a_choice(keymint: Callable, two: Path) -> None:
    names = list(by_name(keymint("verify", "-w", two, "--tier", "decision", "--json").document))
    assert {"board", "board-1", "omg"} <= set(names)
    names = list(by_name(keymint("verify", "-w", two, "robot1/listener", "--json").document))
    assert "omg" in names
    assert not {"board", "board-1"} & set(names)


def test_a_transport_that_no_package_is_built_for(keymint: Callable, two: Path) -> None:
    for verb in (("verify", "robot1/listener"), ("why", "/robot1/listener", "ros_subscribe", "/chatter")):
        outcome = keymint(*verb, "-w", two, "-i", "board-1")
        assert outcome.code == 2
        assert (
            "the transport 'board-1' reads what board builds, but the build type here is keymint_ros2_dds"
            in outcome.err
        )
        assert "-i omg" in outcome.err


def test_a_mismatch_names_the_place_in_the_shared_file_that_decides(keymint: Callable, two: Path) -> None:
    rights = (two / RIGHTS).read_text()
    (two / RIGHTS).write_text(rights + "/talker ALLOW ros_subscribe /chatter\n")
    line = len(rights.splitlines()) + 1
    outcome = keymint("verify", "-w", two, *BOTH, "-i", "board", "--json", "--sarif", "out.sarif", "--junit", "out.xml")
    assert outcome.code == 3
    (found,) = [each for each in outcome.document["diagnostics"] if each["code"] == "false-positive"]
    assert (found["file"], found["line"]) == (f"ws/{RIGHTS}", line)
    assert "but board-1 and board allow it" in found["message"]
    (mismatch,) = by_name(outcome.document)["board"]["findings"]
    assert mismatch["transport"]["explained_by"] == "board-1"
    assert by_name(outcome.document)["omg"]["findings"] == []
    suites = {
        suite.get("name"): [case.get("name") for case in suite.iter("testcase")]
        for suite in etree.parse(two.parent / "out.xml").iter("testsuite")
    }
    assert suites["omg (decision)"] == ["/robot1/listener", "/talker"]
    assert suites["board-1 (decision)"] == ["/talker"]


def test_a_real_transport_gets_keys_and_shared_files_in_the_same_places(keymint: Callable, two: Path) -> None:
    outcome = keymint("verify", "-w", two, "-i", "board", "--tier", "admission", "--json")
    assert outcome.code == 0, outcome.err
    assert by_name(outcome.document)["board"]["confusion"]["true_positive"] > 0


def test_a_build_type_without_a_transport_of_the_tier_is_reported(
    keymint: Callable, two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board.simulated, "open", lambda _: board.Board((), reads_keys=False))
    monkeypatch.setattr(board.real, "open", lambda _: board.Board((), reads_keys=True))
    outcome = keymint("verify", "-w", two)
    message = "what board built is not verified: none of its transports supports the tier decision here"
    assert f"warning: {message} ('keymint transports' shows how to install one)" in outcome.err
    assert "not verified" not in keymint("verify", "-w", two, *DDS).err, "the user chose"


def test_each_build_type_has_a_report_of_its_own(keymint: Callable, two: Path) -> None:
    outcome = keymint("verify", "-w", two, *BOTH, "--report", "report")
    assert outcome.code == 0, outcome.err
    pages = sorted(str(path.relative_to(two.parent / "report")) for path in (two.parent / "report").rglob("index.html"))
    assert pages == ["board/index.html", "dds/index.html"]


def test_why_shows_what_each_transport_must_permit(keymint: Callable, two: Path) -> None:
    outcome = keymint("why", "/talker", "ros_publish", "/chatter", "-w", two, *BOTH)
    assert outcome.code == 0, outcome.err
    assert "needs     publish on the DDS topic 'rt/chatter'\n" in outcome.out
    assert "          ros_publish on the line of the board '/chatter'\n" in outcome.out
    number = (two / RIGHTS).read_text().splitlines().index("/talker ALLOW ros_publish /chatter") + 1
    assert f"allowed by board-1 (ws/{RIGHTS}:{number}: the line ALLOWs ros_publish of '/chatter')" in outcome.out


def test_why_does_not_ask_a_transport_for_a_kind_that_its_build_type_cannot_express(
    keymint: Callable, two: Path
) -> None:
    outcome = keymint("why", "/talker", "publish", "rt/chatter", "-w", two, *BOTH)
    assert outcome.code == 0, outcome.err
    assert "not asked: board-1 (board has no name for the topic 'rt/chatter')" in outcome.out
    assert "allowed by omg" in outcome.out
    assert "line of the board" not in outcome.out


def test_a_rule_on_a_raw_topic_counts_for_its_own_transport_only(keymint: Callable, two: Path, policy: Path) -> None:
    """The policy denies the DDS topic of ``/chatter``: so its decision on DDS is another one than on the board."""
    deny = '<topic qualifier="DENY"><attachment>rt/chatter</attachment><permissions><publish/></permissions></topic>'
    policy.write_text(
        policy.read_text().replace("<attachment>/talker</attachment>", f"<attachment>/talker</attachment>{deny}")
    )
    document = keymint("verify", "-w", two, *BOTH, "--json").document
    wrong = {name: each["confusion"]["false_positive"] for name, each in by_name(document).items()}
    assert wrong["omg"] > 0
    assert wrong["board-1"] == 0
    outcome = keymint("why", "/talker", "ros_publish", "/chatter", "-w", two, *BOTH)
    assert "for keymint_ros2_dds, it denies it: " in outcome.out
    assert "for board, it allows it: " in outcome.out


def test_edges_of_a_graph_that_a_transport_does_not_know_are_reported(keymint: Callable, two: Path) -> None:
    (two.parent / "g.json").write_text(
        '{"format": "keymint-graph", "version": 1, "subjects": ["/talker"], "edges": ['
        '{"subject": "/talker", "permission": "ros_publish", "object": "/chatter", "domain": 0},'
        '{"subject": "/talker", "permission": "publish", "object": "raw", "domain": 0}]}'
    )
    document = keymint("verify", "talker", "-w", two, *BOTH, "-g", "g.json", "--json").document
    counts = {name: sum(each["confusion"].values()) for name, each in by_name(document).items()}
    assert counts == {"omg": 4, "board-1": 2}
    (note,) = [each for each in document["diagnostics"] if each["code"] == "edges-unasked"]
    assert note["message"] == "1 edge of the graph not asked of board-1: board has no name for the topic 'raw'"


def test_the_infrastructure_has_no_rights_to_verify(keymint: Callable, two: Path) -> None:
    outcome = keymint("verify", board.OFFICE, "-w", two)
    assert outcome.code == 1
    assert "office has no rights to verify: it belongs to the infrastructure of a transport" in outcome.err


def test_the_infrastructure_has_no_rights_to_explain_and_none_that_expire(keymint: Callable, two: Path) -> None:
    outcome = keymint("why", f"/{board.OFFICE}", "ros_publish", "/chatter", "-w", two)
    assert outcome.code == 1
    assert "office has no rights to explain: it belongs to the infrastructure of a transport" in outcome.err
    rows = keymint("status", "-w", two, "--json").document["result"]["packages"]
    assert {row["package"] for row in rows if row["permissions_expire"] is None} == {board.OFFICE}


def test_pictures_and_comparisons_of_the_policy_need_no_transport(keymint: Callable, two: Path) -> None:
    for verb in (("diff", two, two), ("graph", "-w", two, "-o", "picture.svg")):
        outcome = keymint(*verb)
        assert outcome.code == 0, outcome.err


def test_transports_names_the_build_type_of_each(keymint: Callable, two: Path) -> None:
    del two
    listed = {
        each["name"]: each["build_type"] for each in keymint("transports", "--json").document["result"]["transports"]
    }
    assert listed["board-1"] == "board"
    assert listed["omg"] == "keymint_ros2_dds"


def test_dds_and_zenoh_from_one_policy(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    """Both decide as the policy does; when it changes, each mismatch is shown in the file that decides."""
    made = keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "zenoh", "--no-prove")
    assert made.code == 0, made.err
    asked = ("-w", "ws", "-i", "omg", "-i", "zenoh-1", "--json")
    found = keymint("verify", *asked)
    assert found.code == 0, found.err
    assert all(each["confusion"]["true_positive"] > 0 for each in by_name(found.document).values())
    policy.write_text(policy.read_text().replace("<ros_subscribe/>", "<ros_publish/>"))
    found = keymint("verify", *asked)
    assert found.code == 3
    wrong = {
        name: {
            (each["error"], each["request"]): Path(each["transport"]["rule"]["file"]).name
            for each in transport["findings"]
        }
        for name, transport in by_name(found.document).items()
    }
    requests = ("false-negative", "ros_publish"), ("false-positive", "ros_subscribe")
    for error, permission in requests:
        request = error, f"/robot1/listener {permission} /chatter"
        assert wrong["omg"][request] == "permissions.xml"
        assert wrong["zenoh-1"][request] == "router.json5"
    assert (tmp_path / "ws/install/zenoh/router.json5").exists()


def test_why_of_a_name_that_zenoh_cannot_have(keymint: Callable, policy: Path) -> None:
    made = keymint("provision", policy, "-w", "ws", "--transport", "zenoh", "--no-prove")
    assert made.code == 0, made.err
    outcome = keymint("why", "/talker", "ros_publish", "/chatter//x", "-w", "ws", "-i", "zenoh-1")
    assert outcome.code == 0, outcome.err
    assert "not asked: zenoh-1 (keymint_ros2_zenoh has no name for the ros_topic '/chatter//x')" in outcome.out
