# SPDX-License-Identifier: Apache-2.0
"""Policies written by people: provisioned unchanged, real access control decides as the policies do."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl

import comarmor

from .agreement import REQUESTS, meanings, operations, said_of
from .provisioning import enclave

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CHECKOUT = Path(__file__).resolve().parents[2]
REFERENCE = CHECKOUT.parent / "shared" / "reference" / "ppac" / "comarmor.d"
POLICIES = [
    *sorted(
        path
        for path in (CHECKOUT / "examples").glob("*/*.xml")
        if not path.name.endswith(".test.xml") and path.name != "package.xml"  # the manifest of a ROS package
    ),
    pytest.param(
        REFERENCE,
        marks=pytest.mark.skipif(not REFERENCE.is_dir(), reason="../shared/reference is not here"),
    ),
]


def names_near(expression: str) -> Iterator[str]:
    """Yield names that the expression matches or almost matches; a class becomes its second character."""
    for text in ("", "w/w") if "*" in expression else ("",):
        name, inside = "", 0
        for letter in expression:
            inside = inside + 1 if letter == "[" or inside else 0
            if letter == "]":
                inside = 0
            elif inside == 0:
                name += {"*": text, "?": text[:1]}.get(letter, letter)
            elif inside == 3:
                name += letter
        yield from (name, f"{name}x")


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@pytest.mark.parametrize("path", POLICIES, ids=lambda path: path.stem)
def test_given_policy(path: Path, provisioned: Callable[[str | Path], Path]) -> None:
    install = provisioned(path)
    policy = comarmor.load(path, library=install.parent / "profile" / "comarmor.d")
    subjects = policy.subjects()
    expressions = {
        expression for subject in subjects for rule in policy.rules(subject) for expression in rule.expressions
    }
    names = sorted({name for expression in expressions for name in names_near(expression)} - {""})
    asked = {each for (_, held), name in product(REQUESTS, names) for each in operations(held, name)}
    asked |= {each for held, name in product(("publish", "subscribe"), names) for each in operations(held, name)}
    allowed = 0
    for subject in subjects:
        with CycloneAccessControl(enclave(install, subject)) as access:
            assert access.valid, (subject, access.reason)
            for each in asked:
                said = said_of(policy, subject, each)
                allowed += said
                assert access.allows(each.direction, each.topic) is said, (subject, each, meanings(each))
    assert allowed > len(subjects)
