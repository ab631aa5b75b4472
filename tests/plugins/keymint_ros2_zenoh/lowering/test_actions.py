# SPDX-License-Identifier: Apache-2.0
"""What a router must permit for an edge."""

from __future__ import annotations

import pytest
from keymint_ros2_zenoh.lowering.permissions import actions, operations

from comarmor.rules import PARTS
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError


def named(permission: str, kind: str, name: str, domain: int = 0) -> list[tuple[str, str]]:
    found = actions("jazzy", Edge("/talker", permission, Object(kind, name), domain))
    assert {(each.subject, each.domain) for each in found} == {("/talker", domain)}
    return [(each.action, each.name) for each in found]


def test_a_publication() -> None:
    data, beside = "3/a/b/*/*", "3/a/b/*/*/@adv/**"
    assert named("ros_publish", "ros_topic", "/a/b", 3) == [
        ("put in", data),
        ("declare subscriber out", data),
        ("reply in", data),
        ("put in", beside),
        ("declare subscriber out", beside),
        ("declare queryable in", beside),
        ("query out", beside),
        ("liveliness token in", beside),
    ]


def test_a_call() -> None:
    key = "0/add/*/*"
    assert named("ros_call", "ros_service", "/add") == [
        ("query in", key), ("reply out", key), ("declare queryable out", key),
    ]  # fmt: skip


@pytest.mark.parametrize(("kind", "permission"), PARTS)
def test_composite_permissions(kind: str, permission: str) -> None:
    expected = [
        each for part_kind, part, suffix in PARTS[kind, permission] for each in named(part, part_kind, f"/n{suffix}")
    ]
    assert named(permission, kind, "/n") == expected


@pytest.mark.parametrize(
    ("kind", "permission", "name", "code"),
    [
        ("topic", "publish", "rt/a", "permission-unknown"),
        ("ros_topic", "ros_relay", "/a", "permission-unknown"),
    ],
)
def test_what_zenoh_does_not_have(kind: str, permission: str, name: str, code: str) -> None:
    with pytest.raises(KeymintError) as caught:
        named(permission, kind, name)
    assert caught.value.diagnostics[0].code == code


@pytest.mark.parametrize("name", ["//a", "/a/", "/a//b", "/", "/a#", "/a*", "/*", "/a$*", "/a?"])
def test_a_name_that_no_key_can_have(name: str) -> None:
    edge = Edge("/talker", "ros_publish", Object("ros_topic", name))
    assert actions("jazzy", edge) == operations(edge) == ()


def test_a_distribution_without_zenoh() -> None:
    with pytest.raises(KeymintError, match="Foxy has no rmw_zenoh"):
        actions("foxy", Edge("/talker", "ros_publish", Object("ros_topic", "/a")))
