# SPDX-License-Identifier: Apache-2.0
"""Rules of the root enclave that depend on a name that it does not have."""

from __future__ import annotations

from pathlib import Path

RULE = '<ros_topic qualifier="ALLOW"><attachment>{}</attachment><permissions><ros_publish/></permissions></ros_topic>'


def codes(keymint, folder: Path, attachment: str, expression: str) -> list[str]:
    profile = f'<profile name="p"><attachment>{attachment}</attachment>{RULE.format(expression)}</profile>'
    (folder / "p.xml").write_text(f"<profiles>{profile}</profiles>")
    return [code for code in keymint("lint", "p.xml", "--json").codes() if code != "node-cannot-start"]


def test_a_rule_with_a_name(keymint, tmp_path: Path) -> None:
    assert codes(keymint, tmp_path, "/", "{namespace}{name}/state") == ["root-name"]
    assert codes(keymint, tmp_path, "/", "{namespace}state") == ["root-name"]
    assert codes(keymint, tmp_path, "/", "/robot/state") == []
    assert codes(keymint, tmp_path, "/robot", "{namespace}{name}/state") == []


def test_the_message_shows_what_the_rule_is_about(keymint, tmp_path: Path) -> None:
    codes(keymint, tmp_path, "/", "{namespace}{name}/state")
    outcome = keymint("lint", "p.xml")
    assert outcome.code == 3
    assert "p.xml:1: warning: the root enclave '/' has no name" in outcome.err
    assert "is about '/state'" in outcome.err


def test_policies_that_differ_for_the_root_enclave_only(keymint, tmp_path: Path) -> None:
    """``/*`` matches it, although it has no name of a node."""
    for name, attachment in (("one", "/*"), ("other", "/?*"), ("third", "/x*")):
        profile = f'<profile name="p"><attachment>{attachment}</attachment>{RULE.format("/chatter")}</profile>'
        (tmp_path / f"{name}.xml").write_text(profile)
    outcome = keymint("diff", "one.xml", "other.xml", "--json").document["result"]
    assert not outcome["equivalent"]
    assert [(each["subject"], each["stands_for"]) for each in outcome["subjects"]] == [("/", None)]
    assert "equivalent" in keymint("diff", "other.xml", "other.xml").out
    of_pattern = keymint("diff", "one.xml", "third.xml", "--json").document["result"]
    assert [each["stands_for"] for each in of_pattern["subjects"]] == ["/*"]
