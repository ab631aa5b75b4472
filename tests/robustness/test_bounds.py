# SPDX-License-Identifier: Apache-2.0
"""Random policies with all features stay within the limits."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.analysis import redundant_rules
from tests.bounds import COMPILE, Sweep, changed
from tests.effort import FULL, calls_of, tries
from tests.families import FAMILIES
from tests.generated import minified, tokens

POLICIES = tries(8, 500)


def test_random_policies(tmp_path: Path) -> None:
    sweep = Sweep(tmp_path)
    for seed in range(POLICIES):
        text = minified(tokens(seed))
        sweep.run(str(seed), text, changed(text))
    tally = sweep.tally
    assert tally.most["compile"][0] < COMPILE
    assert tally.most["lint"][0] < redundant_rules.TOGETHER
    assert len(tally.refused) <= max(1, POLICIES // 50), tally.refused
    assert len(tally.unknown) <= POLICIES // 100, tally.unknown
    assert not tally.unproven


@pytest.mark.parametrize("family", FAMILIES if FULL else ["flat", "nested"])
def test_the_steps_of_a_policy_grow_at_most_with_the_square_of_its_size(tmp_path: Path, family: str) -> None:
    """Where all rules overlap, each is compared with each."""
    few, many = (most_steps(tmp_path, family, size) for size in (100, 200))
    assert all(many[stage] <= 5 * few[stage] for stage in few), (few, many)


def most_steps(folder: Path, family: str, size: int) -> dict[str, int]:
    sweep = Sweep(folder)
    sweep.run(family, FAMILIES[family](size))
    return {stage: steps for stage, (steps, _) in sweep.tally.most.items()}


@pytest.mark.parametrize("family", ["flat", "wild", "nested"])
def test_the_cost_of_the_rules_of_all_subjects_is_linear_in_the_size_of_the_policy(tmp_path: Path, family: str) -> None:
    """A subject is not compared with every attachment."""
    sweep, calls = Sweep(tmp_path), []
    for size in (100, 400):
        policy = sweep.load(FAMILIES[family](size))
        subjects = policy.subjects() or [f"/{'c' if family == 'nested' else 'cell'}{at}/x" for at in range(size // 50)]
        _, count = calls_of(lambda policy=policy, subjects=subjects: [policy.rules(subject) for subject in subjects])
        calls.append(count)
    assert calls[1] < 5 * calls[0]


def test_all_subjects_of_a_rule_share_one_object(tmp_path: Path) -> None:
    policy = Sweep(tmp_path).load(FAMILIES["nested"](50))
    one, other = (policy.rules(subject) for subject in ("/c0/x", "/c0/y"))
    assert one is not None
    assert other is not None
    assert all(mine is theirs for mine, theirs in zip(one.rules, other.rules, strict=True))
