# SPDX-License-Identifier: Apache-2.0
"""Semantic comparison of two policies."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import Origin
from comarmor.patterns.glob import matches, parse
from comarmor.rules import Effect
from keymint.analysis import permission_changes
from keymint.analysis.permission_changes import rule_changes
from keymint.analysis.policy_diff import diff_policies, has_gains
from keymint.analysis.symbolic_search import STATES, QueryBudget
from keymint.ir import Rule
from keymint.output.differences import summary
from tests.keymint.analysis.policies import deny, loaded, profile, rule

PUB = ("ros_topic", "ros_publish")
CALL = ("ros_service", "ros_call")


def changed(folder: Path, old: str, new: str) -> list[tuple[str, str]]:
    one, other = (loaded(folder, text, name=f"{name}.xml") for name, text in (("old", old), ("new", new)))
    return [
        (each.subject, f"{'+' if it.gains else '-'} {it.permission} {'' if it.whole else 'part of '}{it.pattern}")
        for each in diff_policies(one, other)
        for it in each.changes
    ]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ([rule(*PUB, "/a")], [rule(*PUB, "/a")], []),
        ([rule(*PUB, "/[ab]")], [rule(*PUB, "/a"), rule(*PUB, "/b")], []),
        ([rule(*PUB, "/a/*")], [rule(*PUB, "/a/*"), rule(*PUB, "/a/b")], []),
        ([rule(*PUB, "/a")], [rule(*PUB, "/a"), deny(*PUB, "/b")], []),
        ([rule(*PUB, "chatter")], [], []),
        ([], [rule(*PUB, "/a")], ["+ ros_publish /a"]),
        ([rule(*PUB, "/a"), deny(*PUB, "/a")], [rule(*PUB, "/a")], ["+ ros_publish /a"]),
        ([rule(*PUB, "/a/*"), deny(*PUB, "/a/b*")], [rule(*PUB, "/a/*")], ["+ ros_publish /a/b*"]),
        ([rule(*PUB, "/a/*")], [rule(*PUB, "/a/*"), deny(*PUB, "/a/b")], ["- ros_publish /a/b"]),
        ([rule(*PUB, "/a/b")], [rule(*PUB, "/a/*")], ["+ ros_publish part of /a/*"]),
        ([rule(*PUB, "/a")], [rule(*PUB, "/b")], ["+ ros_publish /b", "- ros_publish /a"]),
        ([], [rule("ros_action", "ros_request", "/go")], ["+ ros_request /go"]),
        (
            [rule("ros_action", "ros_request", "/go")],
            [rule("ros_action", "ros_request", "/go"), deny(*CALL, "/go/_action/cancel_goal")],
            ["- ros_call /go/_action/cancel_goal", "- ros_request /go"],
        ),
        ([], [rule(*CALL, "/n/get_*")], ["+ ros_call /n/get_*"]),
        ([], [rule("topic", "publish", "a")], ["+ publish a"]),
    ],
)
def test_of_a_subject(tmp_path: Path, old: list[str], new: list[str], expected: list[str]) -> None:
    said = changed(tmp_path, profile("/s", *old), profile("/s", *new))
    assert sorted(each for _, each in said) == sorted(expected)


def test_partitions(tmp_path: Path) -> None:
    narrowed = rule("topic", "publish", "a").replace(
        "</topic>", "<partitions><partition>p*</partition></partitions></topic>"
    )
    said = changed(tmp_path, profile("/s", rule("topic", "publish", "a")), profile("/s", narrowed))
    assert said == [("/s", "+ publish a in partition 'p*'"), ("/s", "- publish a")]


def test_subjects_that_come_go_or_are_not_named(tmp_path: Path) -> None:
    said = changed(tmp_path, profile("/old", rule(*PUB, "/a")), profile("/guest/*", rule(*PUB, "{namespace}{name}")))
    assert said == [("/old", "- ros_publish /a"), ("/guest/x", "+ ros_publish {namespace}{name}")]
    one, other = (loaded(tmp_path, profile(name)) for name in ("/a", "/b"))
    assert [(each.subject, each.before, each.after) for each in diff_policies(one, other)] == [
        ("/a", True, False),
        ("/b", False, True),
    ]
    assert not has_gains(diff_policies(one, other))


def test_an_example_is_shortest_and_has_its_rule(tmp_path: Path) -> None:
    one, other = (
        loaded(tmp_path, profile("/s")),
        loaded(tmp_path, profile("/s", rule(*PUB, "/x/*"), deny(*PUB, "/x/?"))),
    )
    (found,) = diff_policies(one, other)
    (change,) = found.changes
    assert (change.example, change.where.line, change.whole) == ("/x/aa", 3, False)
    assert has_gains([found])
    assert not has_gains(diff_policies(other, one))


ATOMS = ("/", "a", "b", "*", "?", "[!a]")
NAMES = ["".join(letters) for length in (2, 3, 4) for letters in product("ab/", repeat=length)]
LEGAL = [name for name in NAMES if name[0] == "/" and "//" not in name and name[-1] != "/"]
RULES = st.lists(
    st.builds(
        lambda effect, atoms: Rule(effect, *PUB[:1], PUB[1:], ("/" + "".join(atoms),), (), False, Origin("p", 1)),
        st.sampled_from(list(Effect)),
        st.lists(st.sampled_from(ATOMS), min_size=1, max_size=3),
    ),
    max_size=4,
)


def permitted(rules: list[Rule], name: str) -> bool:
    about = {each.effect for each in rules if any(matches(parse(one), name) for one in each.expressions)}
    return about == {Effect.ALLOW}


@given(RULES, RULES)
def test_what_changes_is_covered_and_what_is_said_is_so(old: list[Rule], new: list[Rule]) -> None:
    found = list(rule_changes(old, new, QueryBudget()))
    for name in LEGAL:
        before, after = permitted(old, name), permitted(new, name)
        if before is not after:
            assert any(each.gains is after and matches(parse(each.pattern), name) for each in found)
        for each in found:
            if each.whole and matches(parse(each.pattern), name):
                assert (before, after) == (not each.gains, each.gains)
    for each in found:
        assert matches(parse(each.pattern), each.example)
        assert (permitted(old, each.example), permitted(new, each.example)) == (not each.gains, each.gains)


def test_a_gain_in_a_namespace_below(tmp_path: Path) -> None:
    # At the top {namespace}a is /a, which is still denied.
    sees = rule("ros_topic", "ros_subscribe", "/*")
    old, new = (profile("/*a?", sees, deny("ros_topic", "ros_subscribe", denied)) for denied in ("{namespace}a", "/a*"))
    one, other = (loaded(tmp_path, text, name=f"{name}.xml") for name, text in (("old", old), ("new", new)))
    assert has_gains(diff_policies(one, other))


@pytest.mark.parametrize(
    ("gaining", "losing", "said"),
    [(0, 1, "no subjects gain, 1 loses"), (1, 0, "1 subject gains, none lose"), (2, 2, "2 subjects gain, 2 lose")],
)
def test_the_summary_is_a_sentence(tmp_path: Path, gaining: int, losing: int, said: str) -> None:
    more = "".join(profile(f"/g{number}", rule(*PUB, "/a")) for number in range(gaining))
    less = "".join(profile(f"/l{number}", rule(*PUB, "/a")) for number in range(losing))
    one, other = (loaded(tmp_path, text, name=f"{name}.xml") for name, text in (("old", less), ("new", more)))
    assert summary(diff_policies(one, other)) == said


@pytest.mark.parametrize(
    ("old", "new", "witness"),
    [
        ("/robot3/base", "/robot[3-4]/base", "/robot4/base"),
        ("/robot1/*", "/robot[12]/*", "/robot2/a"),
        ("/robot?/base", "/robot*/base", "/robot/base"),
        ("/a*", "/[a-b]*", "/b"),
    ],
)
@pytest.mark.parametrize("name", ["/x", "{namespace}x", "/y/{name}"])
def test_a_pattern_of_subjects_grows(tmp_path: Path, old: str, new: str, witness: str, name: str) -> None:
    one, other = (
        loaded(tmp_path, profile(each, rule(*PUB, name)), name=f"{number}.xml")
        for number, each in enumerate((old, new))
    )
    (found,) = diff_policies(one, other)
    assert (found.subject, [change.gains for change in found.changes]) == (witness, [True])
    assert has_gains([found])
    (found,) = (each for each in diff_policies(other, one) if each.like)
    assert (found.subject, [change.gains for change in found.changes]) == (witness, [False])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        # Profiles nested, and what they have in common.
        (profile("/a*", profile("*b", rule(*PUB, "/x"))), profile("*b", profile("/a*", rule(*PUB, "/x")))),
        (profile("/[ab]", profile("/[bc]", rule(*PUB, "/x"))), profile("/b", rule(*PUB, "/x"))),
        # What depends on the subject, said in another way.
        (
            profile("/r[12]/?", rule(*PUB, "{namespace}x")),
            profile("/r1/?", rule(*PUB, "/r1/x")) + profile("/r2/?", rule(*PUB, "/r2/x")),
        ),
        (profile("/*", rule(*PUB, "{namespace}*")), profile("/*", rule(*PUB, "{namespace}*", "{namespace}{name}/x"))),
        (profile("/*", rule(*PUB, "{namespace}[ab]")), profile("/*", rule(*PUB, "{namespace}a", "{namespace}b"))),
        (
            profile("/*", rule(*PUB, "*"), deny(*PUB, "/x/{name}")),
            profile("*", rule(*PUB, "*"), deny(*PUB, "/x/{name}")),
        ),
        # A denial of what nothing allows.
        (
            profile("/*", rule(*PUB, "{namespace}a")),
            profile("/*", rule(*PUB, "{namespace}a"), deny(*PUB, "{namespace}b")),
        ),
    ],
)
def test_equivalent_for_all_subjects(tmp_path: Path, old: str, new: str) -> None:
    assert changed(tmp_path, old, new) == []


def test_a_name_of_two_patterns_is_compared(tmp_path: Path) -> None:
    # /b is no pattern, and no policy names it.
    old, new = (profile("/[ab]", profile("/[bc]", rule(*PUB, name))) for name in ("/x", "/y"))
    assert changed(tmp_path, old, new) == [("/b", "+ ros_publish /y"), ("/b", "- ros_publish /x")]


def test_a_raw_topic_of_any_characters(tmp_path: Path) -> None:
    said = changed(tmp_path, profile("/s"), profile("/s", rule("topic", "publish", "cov\u00e9rt")))
    assert said == [("/s", "+ publish cov\u00e9rt")]


def test_many_nested_wildcards_are_a_product(tmp_path: Path) -> None:
    # Of classes of subjects there would be 6!: in each order the letters may come in.
    inside = rule(*PUB, "/x")
    for letter in "abcdef":
        inside = profile(f"*{letter}*", inside)
    budget = QueryBudget()
    one, other = (
        loaded(tmp_path, text, name=f"{n}.xml") for n, text in enumerate((profile("/y"), profile("/y") + inside))
    )
    found = diff_policies(one, other, budget)
    assert [change.objects for each in found if each.subject for change in each.changes] == [parse("/x")] * 6
    assert all("not listed: " in change.unknown for each in found if not each.subject for change in each.changes)
    assert budget.spent < STATES // 5


def test_a_spent_budget_is_never_equivalent(tmp_path: Path) -> None:
    one, other = (
        loaded(tmp_path, profile(name, rule(*PUB, "/x")), name=f"{len(name)}.xml") for name in ("/s*", "/[st]*")
    )
    assert all(not change.unknown for each in diff_policies(one, other) for change in each.changes)
    found = diff_policies(one, other, QueryBudget(1))
    assert has_gains(found)
    assert all(change.unknown for each in found for change in each.changes)
    assert "not decided for" in summary(found)


def test_a_large_policy_is_compared_by_what_changed(tmp_path: Path) -> None:
    def fleet(number: int) -> str:
        return "".join(
            profile(f"/robot{n}/*", rule(*PUB, "{namespace}*"), deny(*PUB, "*/estop")) for n in range(number)
        )

    spent = []
    for number in (20, 200):
        budget = QueryBudget()
        old = loaded(tmp_path, fleet(number), name="old.xml")
        new = loaded(tmp_path, fleet(number) + profile("/robot3/arm*", rule(*PUB, "/y")), name="new.xml")
        assert [each.like for each in diff_policies(old, new, budget)] == ["/robot3/arm*"]
        spent.append(budget.spent)
    assert spent[1] <= 2 * spent[0]


@pytest.mark.parametrize(("kind", "permission"), [PUB, CALL])
def test_many_rules_are_compared_by_what_changed(kind: str, permission: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    find = permission_changes.find_permitted
    monkeypatch.setattr(permission_changes, "find_permitted", lambda *a, **k: asked.append(a[0]) or find(*a, **k))
    expressions = [f"/robot{number}/{name}" for number in range(200) for name in ("arm", "leg*", "*eye*")]

    def rules(*each: str) -> list[Rule]:
        return [Rule(Effect.ALLOW, kind, (permission,), (one,), (), False, Origin("p", 1)) for one in each]

    old, new = rules(*expressions), rules(*expressions[:-1], "*hand*")
    found = [(each.gains, each.pattern) for each in rule_changes(old, new, QueryBudget())]
    assert found == [(True, "*hand*"), (False, expressions[-1])]
    assert len(asked) < 30
