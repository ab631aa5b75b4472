# SPDX-License-Identifier: Apache-2.0
"""Verbs that meet a policy of another type read it, or say how to import it."""

from __future__ import annotations

import pytest

POLICY = """<policy version="0.2.0"><enclaves><enclave path="/talker"><profiles><profile ns="/" node="talker">
  <topics publish="ALLOW"><topic>chatter</topic></topics>
</profile></profiles></enclave></enclaves></policy>
"""


@pytest.fixture(autouse=True)
def policy(tmp_path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "graph.json").write_text(
        '{"format": "keymint-graph", "version": 1, "subjects": ["/a"], "types": [],'
        ' "edges": [{"subject": "/a", "permission": "ros_publish", "object": "/x", "domain": 0}]}'
    )
    for name in ("policy.xml", "folder/policy.xml"):
        (tmp_path / name).write_text(POLICY)


@pytest.mark.parametrize(
    "words",
    [
        ("lint", "policy.xml"),
        ("query", "policy.xml", "who", "can", "publish", "/chatter"),
        ("diff", "policy.xml", "policy.xml"),
        ("graph", "policy.xml"),
        ("lint", "policy.xml", "--policy-type", "keymint_ros2_sros2"),
    ],
)
def test_verbs_about_policies_read_it(keymint, words) -> None:
    outcome = keymint(*words, "-q")
    assert (outcome.code, outcome.err) == (0, "")


def test_it_is_tested_by_the_expectations_beside_it(keymint, tmp_path) -> None:
    (tmp_path / "policy.test.xml").write_text(
        '<tests><test name="t"><allow subject="/talker" permission="publish" object="/chatter"/>'
        '<deny subject="/talker" permission="publish" object="/other"/></test></tests>'
    )
    outcome = keymint("test", "policy.xml")
    assert outcome.code == 0, outcome.err
    assert outcome.out.startswith("2 of 2 expectations hold")


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (("provision", "policy.xml", "-w", "ws"), "policy.xml"),
        (("provision", "folder", "-w", "ws"), "folder/policy.xml"),
        (("init", "ws", "--policy", "policy.xml"), "policy.xml"),
        (("init", "ws", "--policy", "folder"), "folder/policy.xml"),
        (("fmt", "folder"), "folder/policy.xml"),
        (("lint", "folder"), "folder/policy.xml"),
        (("learn", "policy.xml"), "policy.xml"),
        (("learn", "graph.json", "--policy", "policy.xml"), "policy.xml"),
        (("query", "folder", "who", "can", "publish", "/chatter"), "folder/policy.xml"),
    ],
)
def test_other_verbs_say_how_to_import_it(keymint, tmp_path, words, file: str) -> None:
    outcome = keymint(*words, "--json")
    (found,) = outcome.document["diagnostics"]
    assert (outcome.code, found["code"], found["file"]) == (1, "policy-foreign", file)
    assert found["message"] == "this is an SROS2 policy"
    assert found["help"] == f"keymint import {file} -o comarmor.d"
    assert not (tmp_path / "ws").exists()


def test_a_workspace_that_got_one(keymint, tmp_path) -> None:
    assert keymint("init", "ws").code == 0
    (tmp_path / "ws/profile/comarmor.d/policy.xml").write_text(POLICY)
    outcome = keymint("create", "--all", "-w", "ws", "--json")
    assert outcome.codes() == ["policy-foreign"]
    assert outcome.document["diagnostics"][0]["file"].endswith("ws/profile/comarmor.d/policy.xml")


def test_other_defects_are_reported_as_before(keymint, tmp_path) -> None:
    (tmp_path / "policy.xml").write_text("<profiles><nope/></profiles>")
    assert keymint("lint", "policy.xml", "--json").codes() == ["schema"]
