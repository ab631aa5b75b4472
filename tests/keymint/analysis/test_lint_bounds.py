# SPDX-License-Identifier: Apache-2.0
"""Steps of linting grow linearly with the policy; exceeded limits are reported as notes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from random import Random

import pytest

from comarmor.errors import Diagnostic, Origin
from comarmor.patterns.glob import parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import disjoint
from comarmor.patterns.steps import spend, step_limit
from comarmor.rules import Effect
from keymint.analysis import lint_rules, name_similarity, redundant_rules, subject_patterns
from keymint.analysis.lint_rules import lint
from keymint.analysis.name_similarity import NameTrie
from keymint.ir import Rule, SubjectRules
from tests.effort import calls_of
from tests.families import FAMILIES
from tests.keymint.analysis.policies import loaded_text

Found = list[str]


def linted(folder: Path, text: str) -> tuple[int, Found]:
    policy = loaded_text(folder, text)
    with step_limit(None) as effort:
        found = lint(policy)
    return effort.spent, [each.code for each in found]


@pytest.mark.parametrize("family", ["flat", "wild", "nested", "exact", "bracketed"])
def test_steps_grow_with_the_policy(tmp_path: Path, family: str) -> None:
    few, many = (linted(tmp_path, FAMILIES[family](size))[0] for size in (100, 400))
    assert many < 5 * few


def test_many_profiles(tmp_path: Path) -> None:
    steps, codes = linted(tmp_path, FAMILIES["flat"](1_000))
    assert codes == []
    assert steps < 21 * 1_000


def test_calls_grow_with_the_policy(tmp_path: Path) -> None:
    policies = [loaded_text(tmp_path, FAMILIES["wild"](size)) for size in (50, 200)]
    few, many = (calls_of(partial(lint, policy))[1] for policy in policies)
    assert many < 5 * few


def test_too_many_similar_names_end_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(name_similarity, "STEPS", 200)
    steps, codes = linted(tmp_path, FAMILIES["misspelt"](60))
    assert "lint-unknown" in codes
    assert steps < 2 * 60 * 300


def test_too_complex_checks_end_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = FAMILIES["infixes"](40)
    monkeypatch.setattr(redundant_rules, "UNIT", 100)
    assert linted(tmp_path, text)[1] == ["lint-unknown"]
    monkeypatch.setattr(redundant_rules, "UNIT", 100_000)
    monkeypatch.setattr(redundant_rules, "TOGETHER", 1_000)
    monkeypatch.setattr(redundant_rules, "EACH", 0)
    steps, codes = linted(tmp_path, text)
    assert codes == ["lint-unknown"]
    assert steps < 60_000


def test_too_many_pairs_end_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redundant_rules, "MOST_PAIRS", 20)
    assert "lint-unknown" in linted(tmp_path, FAMILIES["flat"](30))[1]


def test_too_many_overlapping_patterns_end_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "".join(
        f'<profile name="{at}"><attachment>/*{at}*</attachment></profile>' for at in ("a", "b", "c", "d", "e", "f")
    )
    monkeypatch.setattr(subject_patterns, "MOST_EXAMPLES", 3)
    assert "lint-unknown" in linted(tmp_path, f"<profiles>{text}</profiles>")[1]


class Costly:
    """Checks the rules of any subject in ten steps."""

    def check_rules(self, rules: SubjectRules, distro: str) -> Sequence[Diagnostic]:
        del rules, distro
        spend(10)
        return ()


@pytest.mark.parametrize(("limit", "codes"), [(9, ["lint-unknown"]), (10, [])])
def test_the_compiler_ends_with_a_note(monkeypatch: pytest.MonkeyPatch, limit: int, codes: Found) -> None:
    monkeypatch.setattr(lint_rules, "STEPS", limit)
    rules = {
        name: Rule(Effect.ALLOW, "topic", ("publish",), (name,), (), audit=False, origin=Origin("p.xml", 1))
        for name in "ab"
    }
    subjects = [(f"/{name}", (rule,)) for name, rule in rules.items()]
    found = lint_rules.portability(Costly(), "jazzy", subjects)
    assert [each.code for each in found] == codes


def test_pattern_index_finds_overlapping_patterns() -> None:
    rng = Random(7)
    pieces = ("a", "b", "ab", "*", "?", "[ab]", "/")
    for _ in range(150):
        globs = [parse("".join(rng.choice(pieces) for _ in range(rng.randint(1, 4)))) for _ in range(20)]
        near = PatternIndex((glob, at) for at, glob in enumerate(globs))
        wanted = parse("".join(rng.choice(pieces) for _ in range(rng.randint(1, 4))))
        assert sorted(at for _, at in near.meeting(wanted)) == [
            at for at, glob in enumerate(globs) if not disjoint(glob, wanted)
        ]


def test_name_trie_finds_typos() -> None:
    rng = Random(8)

    def name() -> str:
        return "".join(rng.choice("ab/") for _ in range(rng.randint(0, 6)))

    for _ in range(150):
        names, wanted = [name() for _ in range(20)], name()
        for most in (1, 2):
            assert set(NameTrie(names).near(wanted, most)) == {each for each in names if _edits(each, wanted) <= most}


def _edits(one: str, other: str) -> int:
    row = list(range(len(other) + 1))
    for at, char in enumerate(one, 1):
        after = [at]
        for number, char2 in enumerate(other, 1):
            after.append(min(after[-1] + 1, row[number] + 1, row[number - 1] + (char != char2)))
        row = after
    return row[-1]
