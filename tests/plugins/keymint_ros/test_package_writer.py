# SPDX-License-Identifier: Apache-2.0
"""New packages, and changes of the policy: an unedited document follows the policy, an edited one is kept."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from keymint_ros import manifest, package_type, profile_type

from keymint.api import API_VERSION
from keymint.errors import KeymintError
from keymint.ir import SubjectRules

from .workspaces import RULES, Workspace, rules

OLD = b"""<?xml version="1.0" encoding="utf-8"?>
<package>
    <permissions>
        <grant name="talker">
            <allow_rule>
                <ros_publish><ros_topics><ros_topic>/chatter</ros_topic></ros_topics></ros_publish>
            </allow_rule>
            <default>DENY</default>
        </grant>
    </permissions>
</package>
"""


@pytest.fixture
def edited(workspace: Workspace) -> Workspace:
    return workspace.edit("permissions.xml", "/robot1/chatter", "/robot1/mine")


def test_a_new_package_has_four_documents(workspace: Workspace) -> None:
    files = package_type.create(workspace.load_profile(), RULES, {}, force=False)
    assert sorted(files) == ["governance.xml", "identities.xml", "keymint_package.xml", "permissions.xml"]


def test_existing_documents_are_kept(workspace: Workspace) -> None:
    profile = workspace.load_profile()
    assert "identities.xml" not in package_type.create(profile, RULES, {"identities.xml": b"mine"}, force=True)
    others = dict.fromkeys(("governance.xml", "identities.xml"), b"broken")
    existing = {**others, "keymint_package.xml": workspace.package["keymint_package.xml"]}
    assert list(package_type.create(profile, RULES, existing, force=True)) == ["permissions.xml"]


@pytest.mark.parametrize("names", [("mine",), ("mine", "yours"), ("keymint_ros2_dds", "mine")])
def test_the_build_types_come_from_the_profile(workspace: Workspace, names: tuple[str, ...]) -> None:
    elements = "".join(f"<build_type>{name}</build_type>" for name in names)
    other = workspace.edit("profile/keymint_profile.xml", "<export>", f"<export>{elements}")
    files = package_type.create(other.load_profile(), RULES, {}, force=False)
    assert manifest.read(files[manifest.MARKER], "m.xml").build_types == names


def test_nothing_is_written_when_nothing_changed(workspace: Workspace) -> None:
    assert workspace.create(RULES) == {}
    assert workspace.create(RULES, force=True) == {}


def test_a_document_stays_if_only_lines_moved_or_paths_are_written_differently(workspace: Workspace) -> None:
    moved = replace(RULES.rules[0].origin, line=4)
    rules_ = SubjectRules(RULES.subject, (replace(RULES.rules[0], origin=moved), RULES.rules[1]))
    assert workspace.create(rules_) == {}
    (content,) = workspace.create(rules_, force=True).values()
    assert re.search(rb'origin="[^":]*:4[;"]', content)
    spelled = tuple(
        replace(rule, origin=replace(rule.origin, file=rule.origin.file.replace("/ws/", "../ws/")))
        for rule in RULES.rules
    )
    assert workspace.create(SubjectRules(RULES.subject, spelled)) == {}


def test_an_edit_is_kept_while_the_policy_does_not_change(edited: Workspace) -> None:
    assert edited.create(RULES) == {}


def test_an_edit_and_a_change_of_the_policy_conflict(edited: Workspace) -> None:
    with pytest.raises(KeymintError) as error:
        edited.create(rules("/other"))
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "hand-edited"
    assert "--force" in diagnostic.help
    assert str(diagnostic.where) == "robot1/talker/permissions.xml:6"


@pytest.mark.parametrize("new_rules", [RULES, rules("/other")])
def test_force_replaces_an_edit(edited: Workspace, new_rules: SubjectRules) -> None:
    files = edited.create(new_rules, force=True)
    loaded = replace(edited, package={**edited.package, **files}).load().grant.rules
    assert loaded == new_rules


def test_an_edit_that_the_policy_now_contains_is_no_longer_an_edit(workspace: Workspace) -> None:
    edited = workspace.edit("permissions.xml", "/robot1/chatter", "/robot1/mine")
    new_rules = SubjectRules(RULES.subject, (replace(RULES.rules[0], expressions=("/robot1/mine",)), RULES.rules[1]))
    settled = replace(edited, package={**edited.package, **edited.create(new_rules)})
    assert settled.load().grant.rules == new_rules
    assert replace(settled, package={**settled.package, **settled.create(rules("/x"))}).load()


def test_a_document_without_its_digest_counts_as_edited(workspace: Workspace) -> None:
    bare = workspace.edit("permissions.xml", "digest=", "x=")
    bare = replace(bare, package={**bare.package, "permissions.xml": _without_digest(workspace)})
    with pytest.raises(KeymintError, match="edited by hand"):
        bare.create(rules("/other"))
    assert b"digest=" in bare.create(RULES)["permissions.xml"]


def _without_digest(workspace: Workspace) -> bytes:
    before, _, after = workspace.package["permissions.xml"].partition(b' digest="')
    return before + after.partition(b'"')[2]


def test_overrides_of_the_grant_survive_a_change_of_the_policy(workspace: Workspace) -> None:
    tuned = workspace.edit(
        "permissions.xml",
        '<grant name="/robot1/talker">',
        '<grant name="mine"><domains><id>7</id></domains>\n<subject_name>CN=a&amp;b</subject_name>',
    )
    assert tuned.create(RULES) == {}
    files = tuned.create(rules("/other"))
    grant = replace(tuned, package={**tuned.package, **files}).load().grant
    assert (grant.name, grant.domains[0].first, grant.subject_name) == ("mine", 7, "CN=a&b")
    assert grant.rules == rules("/other")


def test_permissions_of_2018_are_replaced_and_backed_up(workspace: Workspace) -> None:
    old = replace(workspace, package={**workspace.package, "permissions.xml": OLD})
    files = old.create(RULES)
    assert files["permissions.xml.2018"] == OLD
    assert files["permissions.xml"] == workspace.package["permissions.xml"]
    again = replace(old, package={**old.package, "permissions.xml.2018": b"first"})
    assert "permissions.xml.2018" not in again.create(RULES)


def test_permissions_of_2018_are_rejected_when_loaded(workspace: Workspace) -> None:
    old = replace(workspace, package={**workspace.package, "permissions.xml": OLD})
    with pytest.raises(KeymintError) as error:
        old.load()
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "permissions-format"
    assert "keymint create robot1/talker" in diagnostic.help


def test_a_broken_document_is_replaced_only_by_force(workspace: Workspace) -> None:
    broken = replace(workspace, package={**workspace.package, "permissions.xml": b"<package"})
    with pytest.raises(KeymintError):
        broken.create(RULES)
    assert broken.create(RULES, force=True) == {"permissions.xml": workspace.package["permissions.xml"]}


def test_the_manifest_gives_the_path_of_the_permissions(workspace: Workspace) -> None:
    manifest = (
        "<permissions><permission><permission_path>my/rules.xml</permission_path></permission></permissions><export>"
    )
    moved = workspace.edit("keymint_package.xml", "<export>", manifest)
    files = moved.create(RULES)
    assert list(files) == ["my/rules.xml"]
    assert replace(moved, package={**moved.package, **files}).load().grant.rules == RULES


def test_the_plugins_have_the_current_api() -> None:
    assert (profile_type.API, package_type.API) == (API_VERSION, API_VERSION)
    assert package_type.MARKER == "keymint_package.xml"
