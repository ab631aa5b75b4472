# SPDX-License-Identifier: Apache-2.0
"""Subjects whose rules repeat nothing are not analysed: the findings are those of an analysis of all subjects."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from keymint.analysis import redundant_rules
from keymint.analysis.lint_rules import lint
from tests.effort import tries
from tests.generated import pretty, tokens
from tests.keymint.analysis.policies import deny, loaded_text, profile, rule

RULES = (
    ("ros_topic", "ros_publish"),
    ("ros_topic", "ros_publish ros_subscribe"),
    ("ros_service", "ros_call"),
    ("ros_parameter", "ros_read"),
    ("topic", "publish"),
)
NAMES = ("/a", "/b", "/c", "{name}", "{namespace}a", "/n", "/n/get_parameters", "no name", "@{T}")
SUBJECTS = ("/n", "/m", "/n/m", "/x/a")


def fleet(seed: int) -> str:
    """Return a policy of profiles with few wildcards and denials that share subjects, so that some repeat nothing."""
    rng = Random(seed)
    profiles = []
    for _ in range(rng.randint(1, 3)):
        rules = []
        for _ in range(rng.randint(1, 4)):
            write = deny if rng.random() < 0.1 else rule
            more = ("/*",) if rng.random() < 0.1 else ()
            rules.append(write(*rng.choice(RULES), *rng.choices(NAMES, k=rng.randint(1, 3)), *more))
        more = "".join(f"<attachment>{each}</attachment>" for each in rng.sample(SUBJECTS[1:], rng.randint(0, 3)))
        profiles.append(profile("/n", more, *rules))
    tunable = '<tunable name="T"><value>/a</value><value>/n</value></tunable>'
    return f"<profiles>{tunable}{''.join(profiles)}</profiles>"


@pytest.mark.parametrize("seed", range(tries(60, 1_000)))
def test_as_if_all_were_analysed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    for text in (fleet(seed), pretty(tokens(seed))):
        policy = loaded_text(tmp_path, text)
        said = lint(policy)
        with monkeypatch.context() as patch:
            patch.setattr(redundant_rules, "_repeat_nothing", lambda _: False)
            assert lint(policy) == said
