# SPDX-License-Identifier: Apache-2.0
"""Legal ROS names."""

from __future__ import annotations

import pytest

from comarmor.rules import is_fully_qualified, is_segment, is_subject


@pytest.mark.parametrize("name", ["/a", "/robot1/talker", "/_x/Y_2"])
def test_legal_names(name: str) -> None:
    assert is_fully_qualified(name)
    assert all(map(is_segment, name[1:].split("/")))


@pytest.mark.parametrize("name", ["", "/", "a", "/a/", "//a", "/1a", "/a-b", "/a\n", "/ä", "/a b"])
def test_illegal_names(name: str) -> None:
    assert not is_fully_qualified(name)
    assert not is_segment(name) or name == "a"


@pytest.mark.parametrize(("name", "is_one"), [("/", True), ("/a/b", True), ("//", False), ("", False), ("a", False)])
def test_the_root_enclave_is_a_subject(name: str, is_one: bool) -> None:
    assert is_subject(name) is is_one
