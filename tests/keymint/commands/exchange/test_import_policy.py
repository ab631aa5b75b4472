# SPDX-License-Identifier: Apache-2.0
"""``keymint import``: what is written, and what stands in the way."""

from __future__ import annotations

from pathlib import Path

import pytest


def policy(rules: str = "", ns: str = "/", more: str = "") -> str:
    return (
        f'<policy version="0.2.0"><enclaves><enclave path="/talker"><profiles><profile ns="{ns}" node="talker">'
        f'<topics publish="ALLOW"><topic>chatter</topic>{rules}</topics></profile></profiles>{more}</enclave>'
        "</enclaves></policy>"
    )


TWO = '<profiles><profile ns="/" node="x"><topics publish="ALLOW"><topic>other</topic></topics></profile></profiles>'


@pytest.fixture(autouse=True)
def foreign(tmp_path: Path) -> Path:
    path = tmp_path / "robot.policy.xml"
    path.write_text(policy())
    return path


def test_it_is_written_proven_and_ready_to_provision(keymint, tmp_path: Path) -> None:
    outcome = keymint("import", "robot.policy.xml")
    assert outcome.code == 0
    (note,) = outcome.err.splitlines()
    assert note.startswith("robot.policy.xml: note: /talker: a node of this subject cannot start on Jazzy with")
    assert "ros_discovery_info" not in note  # SROS2 allows it by itself
    assert outcome.out == (
        "comarmor.d/robot.xml written\n1 subject: 1 proven to permit, for all names, what SROS2 lets it do\n"
    )
    assert keymint("diff", "robot.policy.xml", "comarmor.d/robot.xml").out.startswith("equivalent")
    assert keymint("provision", "comarmor.d", "-w", "ws").code == 0
    assert (tmp_path / "ws/install/enclaves/talker/permissions.p7s").is_file()
    assert keymint("import", "robot.policy.xml").out.startswith("comarmor.d/robot.xml is up to date")


def test_a_path_longer_than_a_common_name_is_imported_and_provisioned(keymint, foreign: Path) -> None:
    """Some versions of SROS2 issue certificates with such names (RFC 5280 allows 64 characters); ours are shortened."""
    path = f"/{'robot_' * 11}arm"
    foreign.write_text(policy().replace('path="/talker"', f'path="{path}"'))
    assert keymint("import", "robot.policy.xml", "--json").codes() == ["node-cannot-start"]
    assert keymint("provision", "comarmor.d", "-w", "ws").code == 0


COMMON = (
    '<profile ns="/" node="talker"><topics publish="ALLOW" subscribe="ALLOW"><topic>parameter_events</topic></topics>'
    '<topics publish="ALLOW"><topic>rosout</topic></topics><topics subscribe="ALLOW"><topic>clock</topic></topics>'
    '<services reply="ALLOW"><service>~/get_parameters</service></services></profile>'
)
"""What SROS2's own ``common/node.xml`` has, but for five of the six services."""


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
def test_the_common_file_of_sros2_starts_no_node_from_iron_on(keymint, foreign: Path, distro: str) -> None:
    foreign.write_text(policy().replace("</profiles>", COMMON + "</profiles>"))
    outcome = keymint("import", "robot.policy.xml", "--distro", distro)
    assert outcome.code == 0
    if distro == "humble":
        assert outcome.err == ""
    else:
        assert "it may not serve any …/get_type_description (include common/node.xml" in outcome.err
    lone = keymint("import", "robot.policy.xml", "--distro", distro, "--no-implicit", "-o", "lone")
    assert "it may not publish ros_discovery_info, subscribe ros_discovery_info" in lone.err


def test_json(keymint) -> None:
    document = keymint("import", "robot.policy.xml", "--json", "-o", "new").document
    assert document["verb"] == "import"
    assert document["result"] == {
        "file": "new/robot.xml", "written": ["new/robot.xml"], "subjects": [{"subject": "/talker", "same": True}],
    }  # fmt: skip


def test_a_dry_run_writes_nothing(keymint, tmp_path: Path) -> None:
    outcome = keymint("import", "robot.policy.xml", "--dry-run")
    assert "would be written" in outcome.out
    assert not (tmp_path / "comarmor.d").exists()


def test_the_graph_is_added_unless_the_owner_says_no(keymint, tmp_path: Path) -> None:
    assert keymint("import", "robot.policy.xml", "-o", "with").code == 0
    assert keymint("import", "robot.policy.xml", "-o", "without", "--no-implicit").code == 0
    assert "node/graph.xml" in (tmp_path / "with/robot.xml").read_text()
    assert "node/graph.xml" not in (tmp_path / "without/robot.xml").read_text()


def test_what_is_enforced_otherwise_takes_a_decision(keymint, foreign: Path, tmp_path: Path) -> None:
    foreign.write_text(policy(more=TWO))
    refused = keymint("import", "robot.policy.xml", "--json")
    assert (refused.code, refused.codes()) == (1, ["sros2-two-profiles"])
    assert not (tmp_path / "comarmor.d").exists()
    accepted = keymint("import", "robot.policy.xml", "--as-written", "--json")
    assert accepted.code == 0
    assert accepted.codes() == ["sros2-two-profiles", "import-changes", "node-cannot-start"]
    changes = accepted.document["diagnostics"][1]
    assert "SROS2's document does not permit it to publish 'rt/other'" in changes["message"]
    assert "(ros_publish /other), and the policy in ComArmor allows it" in changes["message"]
    assert accepted.document["result"]["subjects"] == [{"subject": "/talker", "same": False}]
    assert "/other" in (tmp_path / "comarmor.d/robot.xml").read_text()


def test_what_vendors_read_differently_is_noted(keymint, foreign: Path) -> None:
    """Cyclone DDS checks a topic in both directions: a DENY of one denies the other (docs/vendors.md)."""
    foreign.write_text(
        policy().replace("</topics>", '</topics><topics publish="DENY" subscribe="ALLOW"><topic>x</topic></topics>')
    )
    outcome = keymint("import", "robot.policy.xml", "--json")
    assert outcome.code == 0
    notes = [each for each in outcome.document["diagnostics"] if each["code"] == "import-vendor"]
    assert [each["severity"] for each in notes] == ["note"]
    assert "cyclonedds-0.10 reads SROS2's document differently" in notes[0]["message"]
    assert outcome.document["result"]["subjects"][0]["same"]
    for verb in (("import", "robot.policy.xml"), ("export", "comarmor.d", "--format", "sros2", "-o", "again.xml")):
        listed = keymint(*verb).err
        assert "note: /talker: cyclonedds-0.10 reads SROS2's document differently" in listed
        assert keymint(*verb, "-q").err == ""


def test_a_document_that_is_not_proven_is_not_written(keymint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from keymint_ros2_sros2 import translate

    right = translate.permissions_document
    monkeypatch.setattr(
        translate, "permissions_document", lambda *a, **o: right(*a, **o).replace(b"rt/chatter<", b"rt/chatter*<")
    )
    outcome = keymint("import", "robot.policy.xml", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["import-unproven"])
    assert (
        "/talker: not proven to permit what SROS2's document permits" in outcome.document["diagnostics"][0]["message"]
    )
    assert not (tmp_path / "comarmor.d").exists()


def test_other_files_of_the_folder_are_a_part_of_its_policy(keymint, tmp_path: Path) -> None:
    """The example of a new workspace, for one, would allow /talker more than SROS2 does."""
    assert keymint("init", "ws").code == 0
    outcome = keymint("import", "robot.policy.xml", "-o", "ws/profile/comarmor.d", "--json")
    found = outcome.document["diagnostics"][0]
    assert (outcome.code, found["code"], found["severity"]) == (0, "import-beside", "warning")
    assert "consists of talker_listener.xml too" in found["message"]
    assert keymint("diff", "robot.policy.xml", "ws/profile/comarmor.d").code == 3
    (tmp_path / "ws/profile/comarmor.d/talker_listener.xml").rename(tmp_path / "ws/profile/comarmor.d/x.test.xml")
    again = keymint("import", "robot.policy.xml", "-o", "ws/profile/comarmor.d", "--json")
    assert again.codes() == ["node-cannot-start"]


def test_an_existing_file_is_kept_unless_forced(keymint, tmp_path: Path) -> None:
    target = tmp_path / "comarmor.d/robot.xml"
    target.parent.mkdir()
    target.write_text("mine")
    assert keymint("import", "robot.policy.xml", "--json").codes() == ["import-exists"]
    assert target.read_text() == "mine"
    assert keymint("import", "robot.policy.xml", "--force").code == 0
    assert target.read_text() != "mine"


def test_a_folder_with_other_common_files_is_refused(keymint, tmp_path: Path) -> None:
    """They would be included in place of the library's, for which the proof holds."""
    (tmp_path / "common/node").mkdir(parents=True)
    (tmp_path / "common/node/graph.xml").write_text("<profile/>")
    outcome = keymint("import", "robot.policy.xml", "-o", ".", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["import-library"])
    assert outcome.document["diagnostics"][0]["file"] == "common/node/graph.xml"
    assert not (tmp_path / "robot.xml").exists()
    assert keymint("init", "ws").code == 0
    assert keymint("import", "robot.policy.xml", "-o", "ws/profile/comarmor.d").code == 0  # has the library itself


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (None, "file-missing"),
        ("<profiles/>", "import-unknown"),
        ("a: b", "import-unknown"),
        ("<policy version='1'/>", "schema"),
        ("<policy version='0.2.0'><enclaves></policy>", "xml-syntax"),
        ("<!DOCTYPE policy><policy version='0.2.0'/>", "xml-doctype"),
    ],
)
def test_what_is_no_policy_of_another_tool(keymint, foreign: Path, content: str | None, code: str) -> None:
    foreign.unlink()
    if content is not None:
        foreign.write_text(content)
    assert keymint("import", "robot.policy.xml", "--json").codes() == [code]


def test_every_defect_is_reported(keymint, foreign: Path) -> None:
    foreign.write_text(policy("<topic>~x</topic><topic> y </topic>", ns="a"))
    assert keymint("import", "robot.policy.xml", "--json").codes() == ["sros2-namespace", "sros2-tilde", "sros2-padded"]
