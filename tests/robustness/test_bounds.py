# SPDX-License-Identifier: Apache-2.0
"""Random policies with all features stay within the limits; a sample of ``python benchmarks/bounds.py``."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.analysis import redundant_rules
from tests.bounds import COMPILE, Sweep
from tests.effort import calls_of, tries
from tests.families import FAMILIES
from tests.generated import minified, tokens

SAMPLE = tries(8, 30)


def test_random_policies(tmp_path: Path) -> None:
    sweep = Sweep(tmp_path)
    for seed in range(SAMPLE):
        sweep.run(str(seed), minified(tokens(seed)))
    tally = sweep.tally
    assert tally.most["compile"][0] < COMPILE
    assert tally.most["lint"][0] < redundant_rules.TOGETHER
    assert len(tally.refused) <= 1, tally.refused
    assert not tally.unknown


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
