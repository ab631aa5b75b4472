# SPDX-License-Identifier: Apache-2.0
"""What compiling may cost: counted in steps, refused beyond them with a place and what to do, never left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.compiling import grant_compiler as compiling
from keymint_ros2_dds.emit import emission
from keymint_ros2_dds.settings import package_of

from comarmor.patterns.steps import step_limit
from keymint.analysis.subject_patterns import rules_of
from keymint.api import BuildOptions, LoadedPolicy
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests.families import FAMILIES
from tests.generated import pretty, tokens
from tests.keymint.analysis.policies import loaded_text

MOST = 2 * compiling.STEPS + emission.STEPS


def steps_of(policy: LoadedPolicy, subject: str, *, vendor_specific: bool = False) -> tuple[int, str]:
    """Return the steps that compiling a subject took, and the codes of what refused it."""
    package = package_of(SubjectRules(subject, rules_of(policy, subject)), "humble")
    with step_limit(None) as effort:
        try:
            build_type.build(package, BuildOptions(allow_vendor_specific=vendor_specific))
        except KeymintError as error:
            refused = error.diagnostics
        else:
            refused = ()
    assert all(each.where and each.where.line and each.help for each in refused)
    return effort.spent, refused[0].code if refused else ""


@pytest.mark.parametrize(
    ("family", "size"), [("infixes", 100), ("bracketed", 20), ("partitioned", 12), ("exact", 1000), ("tunables", 50)]
)
def test_families(tmp_path: Path, family: str, size: int) -> None:
    policy = loaded_text(tmp_path, FAMILIES[family](size))
    steps, _ = steps_of(policy, "/s")
    assert steps < MOST


def test_exact_rules_cost_little(tmp_path: Path) -> None:
    costs = [steps_of(loaded_text(tmp_path, FAMILIES["exact"](size)), "/s")[0] for size in (250, 1000)]
    assert costs[1] < 5 * costs[0] + 1_000


@pytest.mark.parametrize("seed", [19, 59, 105])
def test_topics_in_partitions_beside_others(tmp_path: Path, seed: int) -> None:
    """Some of these took minutes, and were refused in the end: every intersection of all patterns was looked for."""
    policy = loaded_text(tmp_path, pretty(tokens(seed)))
    subject = max(policy.subjects(), key=lambda name: len(rules_of(policy, name)))
    steps, _ = steps_of(policy, subject)
    assert steps < MOST


def test_an_end_is_an_error_with_its_place_and_a_way_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "STEPS", 3_000)
    policy = loaded_text(tmp_path, FAMILIES["infixes"](60))
    steps, code = steps_of(policy, "/s")
    assert code == "portability-effort"
    assert steps < 20_000
    assert steps_of(policy, "/s", vendor_specific=True)[1] == ""


def test_a_proof_that_ends_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emission, "STEPS", 20)
    policy = loaded_text(tmp_path, FAMILIES["bracketed"](8))
    package = package_of(SubjectRules("/s", rules_of(policy, "/s")), "humble")
    found = build_type.build(package, BuildOptions()).diagnostics
    assert "compile-unproven" in [each.code for each in found]
