# SPDX-License-Identifier: Apache-2.0
"""``diff`` agrees with brute force."""

from __future__ import annotations

import pytest

from tests.effort import tries
from tests.keymint.analysis.differential import asked, compared, pair
from tests.keymint.analysis.policies import profile, rule

PAIRS = tries(30, 5_000)
CHUNK = 10
PUB = ("ros_topic", "ros_publish")


@pytest.mark.parametrize("first", range(0, PAIRS, CHUNK))
def test_pairs_that_are_one_edit_apart(first: int) -> None:
    for seed in range(first, first + CHUNK):
        name, old, new = pair(seed)
        verdict = compared(old, new)
        assert not verdict.wrong, f"seed {seed}, {name}: {verdict.wrong}"


def test_the_oracle_sees_what_is_missed() -> None:
    """A test that cannot fail is none: brute force finds a difference where there is one."""
    old, new = (f"<profiles>{profile(name, rule(*PUB, '/a'))}</profiles>" for name in ("/a*", "/[ab]*"))
    verdict = compared(old, new)
    assert verdict.differs
    assert not verdict.wrong


@pytest.mark.parametrize("first", range(0, tries(30, 60), CHUNK))
def test_who_holds_a_permission(first: int) -> None:
    for seed in range(first, first + CHUNK):
        answer = asked(seed)
        assert (answer.wrong, answer.perhaps) == ("", False), f"seed {seed}"
