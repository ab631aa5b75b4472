# SPDX-License-Identifier: Apache-2.0
"""What SROS2 enforces differently from what a policy says is an error with its line."""

from __future__ import annotations

import pytest
from keymint_ros2_sros2.deviations import ACCEPTABLE, deviations
from keymint_ros2_sros2.parse import parse

from .sros2_policies import enclave, policy


def topic(text: str) -> str:
    return f'<topics publish="ALLOW"><topic>{text}</topic></topics>'


PROFILES = '<profiles><profile ns="/" node="n"/></profiles>'


@pytest.mark.parametrize(
    ("enclaves", "code", "acceptable"),
    [
        ([f'<enclave path="/a">{PROFILES * 2}</enclave>'], "sros2-two-profiles", True),
        ([enclave("/a", ""), enclave("/a", "")], "sros2-path-twice", True),
        ([enclave("/a", topic("~x"))], "sros2-tilde", True),
        ([enclave("/a", topic(" x "))], "sros2-padded", True),
        ([enclave("/a", "", ns=" /x")], "sros2-padded", True),
        ([enclave("/a", "", ns="x")], "sros2-namespace", True),
        ([enclave("/a", topic("x\\*"))], "sros2-backslash", True),
        ([enclave("/a", topic(" "))], "sros2-empty", False),
        ([enclave("/a*", "")], "sros2-path", False),
        ([enclave("a", "")], "sros2-path", False),
        ([enclave("/" + "a" * 256, "")], "sros2-path", False),
        ([enclave("/a" * 513, "")], "sros2-path", False),
        ([enclave("/../a", "")], "sros2-path", False),
        ([enclave("//", "")], "sros2-path", False),
    ],
)
def test_found(write, enclaves: list[str], code: str, acceptable: bool) -> None:
    found = deviations(parse(write(policy("\n", *(f"{each}\n" for each in enclaves)))))
    assert {each.code for each in found} >= {code}
    each = next(each for each in found if each.code == code)
    assert (code in ACCEPTABLE) == acceptable
    assert each.where is not None
    assert each.where.line == len(enclaves) + 1
    assert each.help


def test_both_names_are_given(write) -> None:
    (found,) = deviations(parse(write(policy(enclave("/a", topic("~x"), ns="/ns", node="n")))))
    assert "SROS2 enforces '/ns/nx', not '/ns/n/x'" in found.message


def test_all_names_that_are_no_expression_are_found(write) -> None:
    found = deviations(parse(write(policy("\n", enclave("/a", topic("[z-a]")), "\n", enclave("/b", topic("[9-0]"))))))
    assert [(each.code, each.where.line, each.code in ACCEPTABLE) for each in found] == [
        ("expression", 2, False), ("expression", 3, False),
    ]  # fmt: skip


def test_nothing_in_a_plain_policy(robot) -> None:
    assert deviations(parse(robot)) == ()


def test_a_node_twice_in_version_0_1_0(write) -> None:
    profile = '<profile ns="/" node="n"/>'
    found = deviations(parse(write(f'<policy version="0.1.0"><profiles>{profile * 2}</profiles></policy>')))
    assert [each.code for each in found] == ["sros2-path-twice"]
