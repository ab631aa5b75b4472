# SPDX-License-Identifier: Apache-2.0
"""The root enclave ``/``: all verbs, and its files among those that all enclaves share."""

from __future__ import annotations

import shutil
import stat
from pathlib import Path

import pytest

from keymint.client import Client
from tests.conftest import CHECKOUT, NOW, snapshot

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="root">
    <attachment>/</attachment>
    <xi:include href="common/node/graph.xml" parse="xml"/>
    <xi:include href="common/node/logging.xml" parse="xml"/>
    <xi:include href="common/node/parameter_events.xml" parse="xml"/>
    <ros_service qualifier="ALLOW">
      <attachment>/one/get_type_description</attachment>
      <permissions><ros_execute/></permissions>
    </ros_service>
    <ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
  <profile name="talker">
    <attachment>/talker</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW"><attachment>/chatter</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
</profiles>
"""
OWN = {
    "cert.pem", "key.pem", "identity_ca.cert.pem", "permissions_ca.cert.pem", "governance.p7s", "permissions.p7s",
    "permissions.xml",
}  # fmt: skip
SHARED = {"governance.xml", "governance.p7s"}


@pytest.fixture
def ws(keymint, tmp_path: Path) -> Path:
    """A workspace with the root enclave and another one."""
    (tmp_path / "p.xml").write_text(POLICY)
    outcome = keymint("provision", "p.xml", "-w", "ws")
    assert outcome.code == 0, outcome.err
    return tmp_path / "ws"


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.is_file()}


def is_sound(keymint, ws: Path) -> bool:
    outcome = keymint("check", "-w", ws, "--json")
    return (outcome.code, {*outcome.codes()} - {"rights-outlive"}) == (0, set()) and keymint(
        "prove", "-w", ws
    ).code == 0


def test_its_files_lie_around_the_other_enclaves(keymint, ws: Path) -> None:
    enclaves = ws / "install/enclaves"
    assert names(enclaves) == OWN | SHARED
    assert stat.S_IMODE(enclaves.stat().st_mode) == 0o700
    assert stat.S_IMODE((enclaves / "key.pem").stat().st_mode) == 0o600
    assert "<subject_name>OU=" in (enclaves / "permissions.xml").read_text()
    assert ",CN=/</subject_name>" in (enclaves / "permissions.xml").read_text()
    assert is_sound(keymint, ws)
    before = snapshot(ws)
    assert "nothing to do" in keymint("provision", "p.xml", "-w", ws).out
    assert keymint("build", "/", "-w", ws).code == keymint("install", "root-enclave", "-w", ws).code == 0
    assert snapshot(ws) == before


SECTION = (CHECKOUT / "docs/deploying.md").read_text().split("## The root enclave")[1].split("\n## ")[0]
EXAMPLE, TUNABLE = (block.removeprefix("xml\n") for block in SECTION.split("```")[1::2])
"""The policy in the documentation as a user copies it, and what may stand in place of its services."""
PARAMETERS = (
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
    "set_parameters_atomically",
)  # fmt: skip


NOT_ASKED = ('permission="publish" object="/chatter"', 'permission="call" object="*"')


@pytest.mark.parametrize("distro", ["foxy", "humble", "iron", "jazzy", "rolling"])
def test_a_plain_node_starts_in_the_root_enclave_of_the_documentation(keymint, tmp_path: Path, distro: str) -> None:
    """What rclpy and rclcpp ask for, in their order (measured with real nodes on Humble and Jazzy)."""
    asked = [
        ("publish", "ros_discovery_info", "topic"), ("subscribe", "ros_discovery_info", "topic"),
        ("publish", "/rosout", ""), ("publish", "/parameter_events", ""), ("subscribe", "/parameter_events", ""),
        *(("execute", f"{node}/{name}", "") for node in ("/listener", "/robot1/any") for name in PARAMETERS),
        ("execute", "/listener/get_type_description", ""), ("subscribe", "/clock", ""), ("subscribe", "/chatter", ""),
    ]  # fmt: skip
    allowed = "".join(
        f'<allow subject="/" permission="{permission}" object="{name}"' + (f' kind="{kind}"' if kind else "") + "/>"
        for permission, name, kind in asked
    )
    denied = "".join(f'<deny subject="/" {each}/>' for each in NOT_ASKED)
    (tmp_path / "p.xml").write_text(EXAMPLE)
    (tmp_path / "p.test.xml").write_text(f'<tests><test name="starts">{allowed}{denied}</test></tests>')
    tested = keymint("test", "p.xml", "--distro", distro)
    assert tested.code == 0, tested.err
    assert f"{len(asked) + 2} of {len(asked) + 2} expectations hold" in tested.out
    assert keymint("lint", "p.xml", "--distro", distro, "--json").codes() == []
    assert keymint("provision", "p.xml", "-w", "ws", "--distro", distro).code == 0
    assert is_sound(keymint, tmp_path / "ws")


def test_the_names_of_its_nodes_may_stand_in_a_tunable(keymint, tmp_path: Path) -> None:
    services = EXAMPLE[EXAMPLE.index("  <ros_service") : EXAMPLE.index("</ros_service>") + len("</ros_service>")]
    (tmp_path / "p.xml").write_text(EXAMPLE.replace(services, TUNABLE))
    assert keymint("lint", "p.xml", "--json").codes() == []
    for name, answer in (("/listener", "yes: / ros_execute"), ("/talker", "no: / can never")):
        asked = keymint("query", "p.xml", "can", "/", "execute", f"{name}/get_type_description")
        assert asked.out.startswith(answer)


def test_what_is_asked_about_it(keymint, ws: Path, tmp_path: Path) -> None:
    verified = keymint("verify", "/", "-w", ws, "-i", "omg", "-i", "cyclonedds-0.10", "-i", "fastdds-2.9", "--json")
    assert (verified.code, verified.codes()) == (0, [])
    why = keymint("why", "/", "ros_publish", "/chatter", "-i", "cyclonedds-0.10", "-w", ws)
    assert why.code == 0
    assert "allowed by cyclonedds-0.10" in why.out
    assert "/ ros_subscribe /chatter" in keymint("query", "p.xml", "who", "can", "subscribe", "/chatter").out
    assert keymint("graph", "p.xml", "-o", "p.dot").code == 0
    assert "/ ros_subscribe /chatter" in (tmp_path / "p.dot").read_text()
    assert "root-enclave  installed" in keymint("status", "-w", ws).out
    assert "/ " in keymint("issued", "/", "-w", ws).out
    assert "ROS_SECURITY_ENCLAVE_OVERRIDE=/\n" in keymint("env", "/", "-w", ws).out


def test_renewed_and_revoked(keymint, ws: Path) -> None:
    key = (ws / "install/enclaves/key.pem").read_bytes()
    assert keymint("renew", "/", "--rekey", "-w", ws).code == 0
    assert (ws / "install/enclaves/key.pem").read_bytes() != key
    assert is_sound(keymint, ws)
    outcome = keymint("revoke", "/", "--reason", "superseded", "-w", ws)
    assert "restart with the new certificate: /\n" in outcome.out
    assert {"crl.pem"} < names(ws / "install/enclaves")
    assert (ws / "install/enclaves/crl.pem").read_bytes() == (ws / "install/enclaves/talker/crl.pem").read_bytes()
    assert is_sound(keymint, ws)


def test_pruned_the_others_keep_what_they_share(keymint, ws: Path) -> None:
    shutil.rmtree(ws / "src/root-enclave")
    outcome = keymint("check", "-w", ws, "--json")
    assert outcome.codes() == ["enclave-orphaned", "subjects-uncreated"]
    assert keymint("build", "-w", ws).code == 0
    assert keymint("install", "--prune", "-w", ws).code == 0
    assert names(ws / "install/enclaves") == SHARED
    assert names(ws / "install/enclaves/talker") == OWN
    assert keymint("check", "-w", ws, "--json").codes() == ["subjects-uncreated"]
    assert keymint("prove", "-w", ws).code == 0


def test_the_last_enclave_is_pruned(keymint, ws: Path) -> None:
    for name in ("root-enclave", "talker"):
        shutil.rmtree(ws / "src" / name)
    assert keymint("install", "--prune", "-w", ws).code == 3  # the policy names them
    assert names(ws / "install/enclaves") <= {"governance.xml"}


def test_revoked_for_good_it_leaves_the_others(keymint, ws: Path) -> None:
    assert keymint("revoke", "/", "--reason", "key-compromise", "-w", ws).code == 0
    assert names(ws / "install/enclaves") == SHARED
    assert keymint("check", "-w", ws).code == 0
    assert keymint("renew", "/", "--rekey", "-w", ws).code == 0
    assert names(ws / "install/enclaves") == {*OWN, *SHARED, "crl.pem"}
    assert is_sound(keymint, ws)


def test_added_later_and_changed(keymint, ws: Path, tmp_path: Path) -> None:
    lone = POLICY.replace("<attachment>/</attachment>", "<attachment>/other</attachment>")
    (tmp_path / "lone.xml").write_text(lone)
    assert keymint("provision", "lone.xml", "-w", "later").code == 0
    assert names(tmp_path / "later/install/enclaves") == SHARED
    assert keymint("provision", "p.xml", "-w", "later", "--yes").code == 0
    assert names(tmp_path / "later/install/enclaves") == OWN | SHARED
    (tmp_path / "p.xml").write_text(POLICY.replace("/chatter", "/gossip"))
    assert keymint("provision", "p.xml", "-w", ws, "-j", "2").code == 0
    assert is_sound(keymint, ws)


@pytest.mark.parametrize("file", ["governance.p7s", "cert.pem", "permissions.p7s"])
def test_a_changed_file_is_found_and_restored(keymint, ws: Path, file: str) -> None:
    path = ws / "install/enclaves" / file
    path.write_bytes((ws / "install/enclaves/talker" / file).read_bytes()[:-1])
    assert keymint("check", "-w", ws).code == 3
    assert keymint("install", "-w", ws).code == 0
    assert is_sound(keymint, ws)


def test_a_file_that_is_nobodys_is_reported_once(keymint, ws: Path) -> None:
    (ws / "install/enclaves/notes.txt").write_text("?")
    outcome = keymint("check", "-w", ws, "--json")
    assert outcome.codes() == ["file-unexpected"]
    assert "belongs to no enclave" in outcome.document["diagnostics"][0]["message"]


def test_on_a_robot(keymint, ws: Path, tmp_path: Path) -> None:
    """By a bundle with its key, and by a request whose key never leaves the robot."""
    shown = keymint("authority", "show", "identity_ca", "-w", ws, "--json").document
    trust = ("--authority-fingerprint", shown["result"]["authorities"][0]["certificate"]["fingerprint"])
    assert keymint("bundle", "/", "/talker", "-w", ws, "-o", tmp_path).code == 0
    assert keymint("accept", "root-enclave.bundle", "talker.bundle", "--folder", "one", "--new", *trust).code == 0
    assert names(tmp_path / "one/enclaves") == {*OWN, "bundle.json"}
    assert names(tmp_path / "one/enclaves/talker") == {*OWN, "bundle.json"}

    asked = keymint("request", "/", "--folder", "two", "--json").document["result"]
    assert asked["enclave"] == "/"
    told = f"/={asked['fingerprint']}"
    outcome = keymint("sign", "root-enclave.request.pem", "--fingerprint", told, "-w", ws, "-o", "answer")
    assert outcome.code == 0, outcome.err
    (ws / "private/identities/root-enclave/key.pem").unlink()
    assert keymint("accept", "answer", "--folder", "two", *trust).code == 0
    assert names(tmp_path / "two/enclaves") == {*OWN, "bundle.json"}
    assert is_sound(keymint, ws)


def test_from_a_program(ws: Path) -> None:
    assert Client(ws).provision("/").folder == ws / "install/enclaves"


def test_a_common_name_alone_is_refused(keymint, tmp_path: Path) -> None:
    """On Cyclone DDS ``CN=/`` may use every grant."""
    (tmp_path / "p.xml").write_text(POLICY)
    outcome = keymint("provision", "p.xml", "-w", "sros2", "--subject-format", "sros2", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["portability-root-name"])
    assert "can use the permissions of every other enclave" in outcome.document["diagnostics"][0]["message"]
    assert not (tmp_path / "sros2").exists()
    lenient = keymint("provision", "p.xml", "-w", "sros2", "--subject-format", "sros2", "--allow-vendor-specific")
    assert lenient.code == 0
    assert "warning: the root enclave is named 'CN=/' alone" in lenient.err


def test_a_name_that_cyclone_dds_cannot_split_is_refused(keymint, ws: Path) -> None:
    for file in ("identities.xml", "permissions.xml"):
        defaults = ws / "profile/package.defaults" / file
        text = defaults.read_text().replace("OU={unique},CN={common_name}", "OU=x,CN=/")
        defaults.write_text(text)
    outcome = keymint("build", "/", "-w", ws, "--json")
    assert (outcome.code, outcome.codes()) == (1, ["portability-subject-name"])
    assert "put a CN that ends with '/' first" in outcome.document["diagnostics"][0]["help"]


def test_the_flat_layout_has_no_place_for_it(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(POLICY.replace('<xi:include href="common/node/graph.xml" parse="xml"/>', ""))
    outcome = keymint("provision", "p.xml", "-w", "flat", "--distro", "dashing", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["root-enclave"])
    assert not (tmp_path / "flat").exists()


def test_a_policy_of_sros2_there_and_back(keymint, tmp_path: Path) -> None:
    node = '<profile ns="/" node="talker"><topics publish="ALLOW"><topic>chatter</topic></topics></profile>'
    enclave = f'<enclave path="/"><profiles>{node}</profiles></enclave>'
    (tmp_path / "policy.xml").write_text(f'<policy version="0.2.0"><enclaves>{enclave}</enclaves></policy>')
    assert keymint("import", "policy.xml", "-o", "imported").code == 0
    assert "equivalent" in keymint("diff", "policy.xml", "imported").out
    assert keymint("export", "imported", "--format", "sros2", "-o", "again.xml").code == 0
    assert "equivalent" in keymint("diff", "again.xml", "imported").out


def test_with_zenoh(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(POLICY)
    assert keymint("provision", "p.xml", "-w", "both", "--transport", "dds", "--transport", "zenoh").code == 0
    both = tmp_path / "both"
    assert names(both / "install/enclaves") == {*OWN, *SHARED, "session.json5"}
    assert is_sound(keymint, both)
    assert keymint("verify", "/", "-w", both, "-i", "zenoh-1").code == 0


def test_a_keystore_with_a_common_name_alone_is_adopted_unchanged(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(POLICY)
    shape = ("--subject-format", "sros2", "--allow-vendor-specific")
    assert keymint("provision", "p.xml", "-w", "made", *shape).code == 0
    outcome = keymint("adopt", "made/install", "p.xml", "--apply", "-w", "taken")
    assert outcome.code == 0, outcome.err
    before = snapshot(tmp_path / "made/install/enclaves")
    after = snapshot(tmp_path / "taken/install/enclaves")
    assert {path: content for path, (_, _, content) in after.items()} == {
        path: content for path, (_, _, content) in before.items()
    }
    assert "names-confused" in keymint("check", "-w", "taken", "--json").codes()


def test_it_is_named_when_it_is_due_next(keymint, ws: Path) -> None:
    keymint("renew", "talker", "-w", ws, env={"SOURCE_DATE_EPOCH": str(NOW + 86_400)})
    outcome = keymint("renew", "-w", ws)
    assert (outcome.code, outcome.out.split(",")[0]) == (0, "nothing is due; next is /")
    assert keymint("renew", "-w", ws, "--json").document["result"]["next"]["subject"] == "/"
