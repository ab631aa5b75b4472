# SPDX-License-Identifier: Apache-2.0
"""The plugin: ComArmor to the intermediate representation."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_comarmor import policy_type

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.api import PolicySource
from keymint.errors import KeymintError

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="talker" modifier="AUDIT">
    <attachment>/robot1/talker</attachment>
    <xi:include href="common/node.xml"/>
  </profile>
  <profile name="other"><attachment>*/other</attachment></profile>
</profiles>
"""
NODE = """<topic qualifier="DENY">
  <attachment>{namespace}x</attachment><attachment>{namespace}[^a]</attachment>
  <permissions><subscribe/><publish/></permissions><partitions><partition>p</partition></partitions>
</topic>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "policy.xml").write_text(POLICY)
    (tmp_path / "common").mkdir()
    (tmp_path / "common" / "node.xml").write_text(NODE)
    return tmp_path


def source(path: Path) -> PolicySource:
    return PolicySource("example", path, Origin("profile/policies.xml", 3))


def test_rules_are_expanded_and_have_their_origin(folder) -> None:
    loaded = policy_type.load([source(folder)], None)
    assert loaded.subjects() == ("/robot1/talker",)
    found = loaded.rules("/robot1/talker")
    assert found is not None
    assert found.subject == "/robot1/talker"
    (rule,) = found.rules
    assert (rule.effect, rule.kind, rule.permissions) == (Effect.DENY, "topic", ("publish", "subscribe"))
    assert rule.expressions == ("/robot1/x", "/robot1/[!a]")
    assert rule.partitions == ("p",)
    assert rule.audit
    outer = Origin(f"{folder}/policy.xml", 4, (), 5)
    assert rule.origin == Origin(f"{folder}/common/node.xml", 1, (outer,), 1)
    assert {"policy.xml", "node.xml"} <= {path.name for path in loaded.seen}
    assert all(policy_type.fingerprint(path) == seen for path, seen in loaded.seen.items())


def test_paths_are_named_as_they_were_given(folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    rules = policy_type.load([source(Path("policy.xml"))], None).rules("/robot1/talker")
    assert rules is not None
    assert str(rules.rules[0].origin) == "common/node.xml:1, included from policy.xml:4"


def test_subject_without_rules_differs_from_one_without_profile(folder) -> None:
    loaded = policy_type.load([source(folder)], None)
    other = loaded.rules("/a/other")
    assert other is not None
    assert other.rules == ()
    assert loaded.rules("/nobody") is None


def test_library(folder, tmp_path_factory) -> None:
    library = tmp_path_factory.mktemp("library")
    (folder / "common").rename(library / "common")
    rules = policy_type.load([source(folder)], library).rules("/robot1/talker")
    assert rules is not None
    assert rules.rules[0].origin.file == f"{library}/common/node.xml"


def test_defects_become_diagnostics(folder) -> None:
    (folder / "common" / "node.xml").write_text(NODE.replace("publish", "publsh"))
    with pytest.raises(KeymintError) as caught:
        policy_type.load([source(folder)], None)
    (found,) = caught.value.diagnostics
    assert found.where is not None
    assert found.where.file == f"{folder}/common/node.xml"
    assert found.where.chain[0].line == 4
    assert found.help == "did you mean 'publish'?"


def test_missing_policy_blames_who_names_it(tmp_path) -> None:
    with pytest.raises(KeymintError) as caught:
        policy_type.load([source(tmp_path / "no")], None)
    assert caught.value.diagnostics[0].where == Origin("profile/policies.xml", 3)
