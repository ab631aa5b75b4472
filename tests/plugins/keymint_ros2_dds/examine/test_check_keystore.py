# SPDX-License-Identifier: Apache-2.0
"""Findings that concern several enclaves of a keystore."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_dds import build_type

from keymint.api import BuildOptions
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.builds import CHATTER
from tests.plugins.keymint_ros2_dds.enclaves import authority, inspection, installed
from tests.plugins.keymint_ros2_dds.packages import package


def seen(subject, name="", distro="jazzy", **authorities):
    loaded = replace(package(CHATTER, subject=subject, name=name), distro=distro)
    return inspection(loaded, installed(loaded, **authorities))


@pytest.mark.parametrize(
    ("identity", "grant", "usable"),
    [
        ("CN=/robot", "CN=/robot/camera", True),
        ("CN=/", "CN=/robot/camera", True),
        ("CN=/a/b", "CN=/b/a", True),
        ("CN=/robot/camera", "CN=/robot", False),
        ("CN=/robot,OU=x1", "CN=/robot/camera,OU=x2", False),
        ("CN=/robot,OU=x1", "OU=x1,CN=/robot", True),
    ],
)
def test_identities_that_may_use_the_grant_of_another_on_cyclone_dds(identity, grant, usable):
    findings = build_type.check_all([seen("/one", identity), seen("/other", grant)])
    assert any((each.code, each.subject) == ("names-confused", "/one") for each in findings) is usable


def test_names_that_a_vendor_confuses():
    found = build_type.check_all([seen("/robot", "CN=/robot"), seen("/robot/camera", "CN=/robot/camera")])
    assert [(each.code, each.subject) for each in found] == [("names-confused", "/robot")]
    assert build_type.check_all([seen("/robot", "OU=a,CN=/robot"), seen("/robot/arm", "OU=b,CN=/robot/arm")]) == ()


@pytest.mark.parametrize(("name", "twice"), [("CN=/b,CN=/a", "CN"), ("OU=1,OU=1,CN=/a", "OU"), ("OU=1,CN=/a", "")])
def test_a_name_that_has_an_attribute_twice_is_confused_by_fast_dds(name: str, twice: str) -> None:
    found = [each for each in build_type.check(seen("/a", name, "humble")) if each.code == "names-confused"]
    assert [(each.code, each.subject) for each in found] == ([("names-confused", "/a")] if twice else [])
    assert all(f"has {twice} twice in its name {name!r}" in each.message for each in found)


@pytest.mark.parametrize(("distro", "builds"), [("humble", True), ("jazzy", False), ("kilted", False)])
def test_a_name_that_finds_no_permissions_of_its_own_is_not_built_where_that_vendor_ships(distro, builds) -> None:
    loaded = replace(package(CHATTER, subject="/a", name="CN=/b,CN=/a"), distro=distro)
    if builds:
        assert build_type.build(loaded, BuildOptions()).documents
    else:
        with pytest.raises(KeymintError, match="an attribute is there twice") as caught:
            build_type.build(loaded, BuildOptions())
        assert [each.code for each in caught.value.diagnostics] == ["portability-subject-name"]
        assert build_type.build(loaded, BuildOptions(allow_vendor_specific=True)).documents


def test_one_authority_for_both_jobs_is_said_once():
    ca = authority("ca").pem
    two = [seen(subject, identity="ca", permissions="ca") for subject in ("/a", "/b")]
    two = [replace(each, chains={"identity": ca, "permissions": ca}) for each in two]
    found = [each for each in build_type.check_all(two) if each.code != "names-confused"]
    assert [each.code for each in found] == ["authority-shared"]
    [note] = build_type.check_all([replace(two[0], layout="flat")])
    assert (note.code, note.severity) == ("authority-shared", "note")


def test_permissions_of_different_authorities():
    chains = {"identity": authority("identity_ca").pem, "permissions": authority("other_ca").pem}
    other = replace(seen("/b", "CN=/b,OU=2", permissions="other_ca"), chains=chains)
    assert [each.code for each in build_type.check_all([seen("/a", "CN=/a,OU=1"), other])] == ["authorities-differ"]
