# SPDX-License-Identifier: Apache-2.0
"""Each change is covered by a line of ``diff``, and each line holds for each subject that it is about."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.analysis.policy_diff import diff_policies, has_gains
from keymint.analysis.symbolic_search import QueryBudget
from keymint.output.differences import as_text
from tests.effort import tries
from tests.keymint.analysis.diff_classes import Pair, judged, pair
from tests.keymint.analysis.policies import deny, loaded_text, profile, rule

PAIRS = tries(30, 5_000)
CHUNK = 10
PUB = ("ros_topic", "ros_publish")
WHOLE = profile("/*", rule(*PUB, "/z"))


@pytest.mark.parametrize("first", range(0, PAIRS, CHUNK))
def test_what_is_printed_is_so_for_all_members(tmp_path: Path, first: int) -> None:
    for seed in range(first, first + CHUNK):
        verdict = judged(tmp_path, pair(seed))
        assert not verdict.wrong, f"seed {seed}: {verdict.wrong[:3]}"


def test_few_classes_are_not_listed(tmp_path: Path) -> None:
    verdicts = [judged(tmp_path, pair(seed)) for seed in range(30, 30 + tries(10, 500))]
    assert any(each.differs for each in verdicts)
    assert sum(each.unknown for each in verdicts) <= sum(each.lines for each in verdicts) // 20


def _pair(old: str, new: str) -> Pair:
    return Pair(f"<profiles>\n{old}</profiles>", f"<profiles>\n{new}</profiles>", "{" in old + new)


NESTED = profile("/*", rule(*PUB, "/t"), profile("/[ab]", deny(*PUB, "/t")))
CASES = {
    "a smaller class gains more": _pair(
        NESTED, profile("/*", rule(*PUB, "/t", "/z"), profile("/[ab]", rule("topic", "publish", "a")))
    ),
    "a smaller class has a denial": _pair(
        profile("/*"), profile("/*", rule(*PUB, "/a/[st]")) + profile("/[ab]*", deny(*PUB, "/a/s"))
    ),
    "only a smaller class gains": _pair(WHOLE, WHOLE + profile("/[ab]", rule(*PUB, "/t"))),
    "a name of the subject meets a fixed pattern": _pair(
        profile("/*"), profile("/*", rule(*PUB, "/a/[st]", "{namespace}{name}/t"))
    ),
    "a subject had it by its name": _pair(
        profile("/*", rule(*PUB, "/{name}")), profile("/*", rule(*PUB, "/{name}", "/b"))
    ),
    "namespaces of some subjects meet a fixed pattern": _pair(
        profile("/*", rule(*PUB, "/a/*")), profile("/*", rule(*PUB, "/a/*", "{namespace}t"))
    ),
    "a denial for a namespace is lifted": _pair(
        profile("/*", rule(*PUB, "/a/*"), deny(*PUB, "{namespace}b")), profile("/*", rule(*PUB, "/a/*"))
    ),
    "another profile applies to some": _pair(profile("/[ab]*"), WHOLE),
    "a part is there for some": _pair(
        profile("/*") + profile("/[ab]*", rule("ros_service", "ros_call", "*")),
        profile("/*", rule("ros_action", "ros_request", "/a"))
        + profile("/[ab]*", rule("ros_service", "ros_call", "*")),
    ),
    "a named subject has it": _pair(profile("/s", rule(*PUB, "/z")), profile("/s", rule(*PUB, "/z")) + WHOLE),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("reverse", [False, True])
def test_a_change_of_some_members(tmp_path: Path, case: str, reverse: bool) -> None:
    written = CASES[case]
    both = (written.new, written.old) if reverse else (written.old, written.new)
    verdict = judged(tmp_path, Pair(*both, written.templates))
    assert (verdict.wrong, verdict.differs, verdict.unknown) == ([], True, 0)


def test_a_spent_budget_makes_no_false_line(tmp_path: Path) -> None:
    for budget in (1, 1_000, 10_000):
        for seed in range(2):
            assert not judged(tmp_path, pair(seed), QueryBudget(budget)).wrong


def test_what_cannot_be_told_apart_is_not_listed(tmp_path: Path) -> None:
    # The denial concerns {namespace}t where namespace and name are equal, as in /b/b: no pattern says that.
    old, new = (
        profile("/*/*b", rule(*PUB, *names), deny(*PUB, "/{name}/t")) for names in (["{namespace}t", "/z"], ["/z"])
    )
    verdict = judged(tmp_path, _pair(old, new))
    assert (verdict.wrong, verdict.unknown > 0) == ([], True)
    one, other = (loaded_text(tmp_path, f"<profiles>{each}</profiles>", name=f"{len(each)}.xml") for each in (old, new))
    found = diff_policies(one, other)
    assert any(line.startswith("  ? not listed: ") for line in as_text(found, str))
    assert has_gains(found)
