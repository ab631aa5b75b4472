# SPDX-License-Identifier: Apache-2.0
"""A policy on one line means what it means with an element on each line, and findings are the same."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from comarmor.errors import Origin
from keymint.analysis.lint_rules import lint
from keymint.analysis.policy_tests import ExpectationChecker
from keymint.api import Expectation
from tests.conftest import Outcome
from tests.effort import FULL, tries
from tests.generated import Tokens, line_in_pretty, minified, pretty, tokens
from tests.keymint.analysis.policies import loaded_text, rule

SEEDS = range(tries(20, 40))
_PLACE = re.compile(r"policy\.xml:\d+")


def _in_pretty(policy: Tokens, where: Origin | None) -> int:
    assert where is not None
    assert where.line == 1
    return line_in_pretty(policy, where.column)


@pytest.mark.parametrize("seed", SEEDS)
def test_lint_and_coverage(tmp_path: Path, seed: int) -> None:
    policy = tokens(seed)
    one, other = loaded_text(tmp_path, pretty(policy)), loaded_text(tmp_path, minified(policy))
    said = [(each.code, _PLACE.sub("", each.message), each.where and each.where.line) for each in lint(one)]
    found = lint(other)
    assert [(each.code, _PLACE.sub("", each.message), _in_pretty(policy, each.where)) for each in found] == said
    expected = Expectation("t", True, "/*", "ros_publish", "/*scan*", "", Origin("t", 1))
    mine, theirs = ExpectationChecker(one), ExpectationChecker(other)
    lines = [line_in_pretty(policy, column) for _, _, column in sorted(theirs.rules())]
    assert lines == [line for _, line, _ in sorted(mine.rules())]
    exercised = [line_in_pretty(policy, column) for _, _, column in sorted(theirs.check(expected).exercised)]
    assert exercised == sorted(line for _, line, _ in mine.check(expected).exercised)


def test_rules_on_one_line_count_one_by_one(keymint: Callable[..., Outcome], tmp_path: Path) -> None:
    rules = "".join(rule("ros_topic", "ros_publish", f"/{name}").strip() for name in "abcd")
    (tmp_path / "p.xml").write_text(
        f'<profiles><profile name="p"><attachment>/s</attachment>{rules}</profile></profiles>'
    )
    (tmp_path / "p.test.xml").write_text(
        '<tests><test name="t"><allow subject="/s" permission="publish" object="/b"/></test></tests>'
    )
    told = keymint("test", "p.xml", "--json").document["result"]
    assert (told["rules"], told["exercised"]) == (4, 1)
    assert keymint("lint", "p.xml").code == 0


@pytest.mark.parametrize("seed", [1, 3, 5] if FULL else [1, 5])
def test_pictures_explanations_and_documents(keymint: Callable[..., Outcome], tmp_path: Path, seed: int) -> None:
    policy = tokens(seed)
    told: list[list[object]] = []
    for folder, text in (("pretty", pretty(policy)), ("minified", minified(policy))):
        root = tmp_path / folder
        (root / "policy").mkdir(parents=True)
        (root / "policy" / "policy.xml").write_text(text)
        subject = loaded_text(tmp_path, text).subjects()[0]
        drawn = keymint("graph", "policy", "-o", "out.dot", cwd=root)
        asked = keymint("query", "policy", "what", "can", subject, cwd=root)
        made = keymint("provision", "policy", "-w", "ws", "--allow-vendor-specific", "--json", cwd=root)
        why = keymint("why", "-w", "ws", subject, "ros_publish", "/r1/scan", cwd=root)
        documents = {
            path.relative_to(root): path.read_text() for path in sorted((root / "ws/build").rglob("permissions.xml"))
        }
        assert documents
        codes = sorted(made.codes())
        outputs = [_PLACE.sub("", each) for each in (drawn.out, asked.out, why.out)]
        told.append([drawn.code, asked.code, made.code, why.code, codes, *outputs, documents])
    assert told[0] == told[1]
