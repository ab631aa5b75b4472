# SPDX-License-Identifier: Apache-2.0
"""Learned rules are written as files that load, in the canonical form, and their sizes are exact."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_comarmor.policy_documents import (
    CommonPart,
    Need,
    document,
    fold,
    fragment,
    literal,
    profiles,
)

import comarmor

SHARED: Need = ("ros_topic", "{namespace}x", "ros_publish", ())
OWN: Need = ("ros_topic", "/{own}", "ros_publish", ())
SERVICE: Need = ("ros_service", "/s", "ros_call", ())


def part(*needs: Need) -> CommonPart:
    covered = {
        subject: frozenset({("ros_topic", f"{subject[:2]}/x", "ros_publish", ())}) for subject in ("/r/a", "/q/b")
    }
    return CommonPart("common_1.xml", frozenset(needs), covered)


@pytest.mark.parametrize("needs", [(SHARED,), (SHARED, SERVICE)])
def test_a_policy_with_an_included_part_loads_and_decides(tmp_path: Path, needs: tuple[Need, ...]) -> None:
    common = part(*needs)
    held = {subject: {*covered, OWN} for subject, covered in common.covered.items()}
    (tmp_path / "policy.d").mkdir()
    (tmp_path / "policy.d" / common.name).write_bytes(fragment(common.needs))
    (tmp_path / "policy.xml").write_bytes(document(held, [common], "policy.d", "a note"))
    assert b"<!-- a note -->\n<profiles" in (tmp_path / "policy.xml").read_bytes()
    policy = comarmor.load(tmp_path / "policy.xml")
    assert policy.subjects() == ("/q/b", "/r/a")
    for subject, name, allowed in (
        ("/r/a", "/r/x", True),
        ("/q/b", "/q/x", True),
        ("/r/a", "/q/x", False),
        ("/r/a", "/{own}", True),
        ("/r/c", "/{own}", False),
    ):
        assert policy.decide(subject, "ros_topic", "ros_publish", name).allowed is allowed
    assert policy.decide("/r/a", "ros_service", "ros_call", "/s").allowed is (SERVICE in needs)


@pytest.mark.parametrize("needs", [(SHARED,), (SHARED, SERVICE)])
def test_a_policy_without_included_parts(needs: tuple[Need, ...]) -> None:
    literal_needs = [("ros_topic", "/x", "ros_publish", ()), SERVICE][: len(needs)]
    whole = document({"p": set(literal_needs)}, (), "")
    assert profiles({"p": fold(map(literal, literal_needs))}) == whole
