# SPDX-License-Identifier: Apache-2.0
"""Findings that concern several enclaves of a keystore."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_dds import build_type

from tests.plugins.keymint_ros2_dds.builds import CHATTER
from tests.plugins.keymint_ros2_dds.enclaves import authority, inspection, installed
from tests.plugins.keymint_ros2_dds.packages import package


def seen(subject, name="", **authorities):
    loaded = package(CHATTER, subject=subject, name=name)
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
