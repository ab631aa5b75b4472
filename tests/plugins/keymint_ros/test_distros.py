# SPDX-License-Identifier: Apache-2.0
"""The policy fragments of each ROS 2 distribution, and the layout that it reads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from keymint_ros import profile_type

import comarmor

from .workspaces import REQUEST, read_folder, write_folder

ARDENT = replace(REQUEST, distro="ardent", layout="")


def test_the_layout_of_ardent_is_flat_unless_another_is_given(tmp_path: Path) -> None:
    profile = profile_type.load(tmp_path, profile_type.bootstrap(ARDENT))
    assert (profile.distro, profile.layout) == ("ardent", "flat")
    assert [authority.name for authority in profile.authorities] == ["ca"]
    given = profile_type.load(tmp_path, profile_type.bootstrap(replace(ARDENT, layout="sros2")))
    assert given.layout == "sros2"
    other = profile_type.load(tmp_path, profile_type.bootstrap(replace(ARDENT, distro="jazzy")))
    assert other.layout == "sros2"


@pytest.mark.parametrize(
    ("kind", "permission", "name", "allowed"),
    [
        ("ros_topic", "ros_publish", "/chatter", True),
        ("ros_topic", "ros_subscribe", "/chatter", False),
        ("ros_topic", "ros_publish", "/parameter_events", True),
        ("ros_topic", "ros_subscribe", "/parameter_events", True),
        ("ros_topic", "ros_subscribe", "/clock", True),
        ("ros_topic", "ros_publish", "/clock", False),
        ("ros_topic", "ros_publish", "/rosout", False),
        ("ros_service", "ros_call", "/talker/get_parameters", True),
        ("ros_service", "ros_call", "/talker/set_parameters_atomically", False),
        ("ros_service", "ros_execute", "/talker/set_parameters_atomically", True),
        ("ros_service", "ros_call", "/listener/get_parameters", False),
        ("ros_service", "ros_execute", "/listener/get_parameters", False),
        ("topic", "publish", "ros_discovery_info", False),
    ],
)
def test_what_a_node_of_ardent_may_do(kind: str, permission: str, name: str, allowed: bool, tmp_path: Path) -> None:
    files = profile_type.bootstrap(ARDENT)
    write_folder(tmp_path, files)
    profile = profile_type.load(tmp_path, files)
    (source,) = profile.policies
    policy = comarmor.load(source.path, library=profile.library)
    assert policy.decide("/talker", kind, permission, name).allowed is allowed


def test_a_lifecycle_node_of_ardent_serves_its_states(tmp_path: Path) -> None:
    policy_file = tmp_path / "policy.xml"
    policy_file.write_text(
        '<profile name="x" xmlns:xi="http://www.w3.org/2001/XInclude"><attachment>/a/x</attachment>'
        '<xi:include href="common/lifecycle_node.xml" parse="xml"/></profile>'
    )
    policy = comarmor.load(policy_file, library=profile_type.library("ardent"))
    assert policy.decide("/a/x", "ros_service", "ros_execute", "/a/x/change_state").allowed
    assert policy.decide("/a/x", "ros_topic", "ros_publish", "/parameter_events").allowed


@pytest.mark.parametrize("distro", ["eloquent", "humble", "rolling"])
def test_a_lifecycle_node_may_do_what_a_node_may_and_serves_its_states(distro: str, tmp_path: Path) -> None:
    policy_file = tmp_path / "policy.xml"
    policy_file.write_text(
        '<profile name="x" xmlns:xi="http://www.w3.org/2001/XInclude"><attachment>/a/x</attachment>'
        '<xi:include href="common/lifecycle_node.xml" parse="xml"/></profile>'
    )
    policy = comarmor.load(policy_file, library=profile_type.library(distro))
    assert policy.decide("/a/x", "ros_service", "ros_execute", "/a/x/change_state").allowed
    assert policy.decide("/a/x", "ros_topic", "ros_publish", "/a/x/transition_event").allowed
    assert policy.decide("/a/x", "ros_topic", "ros_publish", "/rosout").allowed
    assert not policy.decide("/a/x", "ros_service", "ros_execute", "/a/y/change_state").allowed


def test_a_new_profile_has_a_copy_of_the_library() -> None:
    library = read_folder(profile_type.library("jazzy"))
    files = profile_type.bootstrap(replace(REQUEST, policy="../fleet.xml"))
    assert {path: files[f"comarmor.d/{path}"] for path in library} == library
    assert "common/node.xml" in library
    assert [path for path in files if path.startswith("comarmor.d/") and path.count("/") == 1] == []


def test_families_of_distros_differ_only_where_their_nodes_do() -> None:
    bouncy, foxy, iron = (read_folder(profile_type.library(distro)) for distro in ("bouncy", "foxy", "iron"))
    of_names = {"common/cli/nodes.xml", "common/component.xml", "common/tf.xml"}  # these serve type descriptions, too
    for smaller, larger, different in ((bouncy, foxy, set()), (foxy, iron, of_names)):
        assert set(smaller) < set(larger)
        assert {path for path in smaller if smaller[path] != larger[path]} == {"common/node.xml", *different}
