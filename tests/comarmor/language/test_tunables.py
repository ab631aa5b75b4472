# SPDX-License-Identifier: Apache-2.0
"""Tunables: expansion, scopes, the order of declaration and use, and limits."""

from __future__ import annotations

import pytest

from tests.effort import calls_of

from .policies import allow, include, profile, profiles, topics, tunable


def test_every_combination_of_tunables(load) -> None:
    policy = load(
        profiles(
            tunable("R", "/r1", "/r2"),
            tunable("N", "a", "b*"),
            profile(allow("{namespace}@{N}", "@{R}/@{R}"), attachment="@{R}/@{N}"),
        )
    )
    assert policy.subjects() == ("/r1/a", "/r2/a")
    assert topics(policy, "/r1/bb") == ["/r1/a", "/r1/b*", "/r1/r1", "/r1/r2", "/r2/r1", "/r2/r2"]


def test_doubled_slash_of_a_tunable_collapses_and_a_written_one_stays(load) -> None:
    text = profiles(tunable("N", "", "/r/"), profile(allow("/@{N}/x", "/a//@{N}x")))
    assert topics(load(text)) == ["/x", "/r/x", "/a//x", "/a//r/x"]


def test_value_is_an_expression_complete_in_itself(load) -> None:
    text = profiles(tunable("A", "[", "\\*"), tunable("B", "b]"), profile(allow("@{A}@{B}")))
    assert topics(load(text)) == ["\\[b]", "\\*b]"]


def test_value_may_use_other_tunables_and_placeholders(load) -> None:
    policy = load(profiles(tunable("A", "/a", "{namespace}"), tunable("B", "@{A}/b"), profile(allow("@{B}"))))
    assert topics(policy) == ["/a/b", "/b"]


def test_inner_tunable_hides_outer_one(load) -> None:
    policy = load(
        profiles(
            tunable("T", "/outer"),
            profile(tunable("T", "/inner"), allow("@{T}"), profile(allow("@{T}"))),
            profile(allow("@{T}"), attachment="/t"),
        )
    )
    assert topics(policy) == ["/inner", "/inner"]
    assert topics(policy, "/t") == ["/outer"]


@pytest.mark.parametrize(
    "inside",
    [
        (allow("@{T}"), tunable("T", "/inner")),
        (profile(allow("@{T}")), tunable("T", "/inner")),
        (profile(attachment="@{T}"), tunable("T", "/inner")),
        (tunable("U", "@{T}"), tunable("T", "/inner")),
        (include("sub/rule.xml"), tunable("T", "/inner")),
        (allow("@{T}"), include("sub/tunable.xml")),
        (profile(profile(allow("@{T}"))), profile(allow("/x"), tunable("T", "/here")), tunable("T", "/inner")),
    ],
)
def test_tunable_is_declared_before_its_use(refused, inside) -> None:
    found = refused(
        policy=profiles(tunable("T", "/s"), "\n", profile(*inside)),
        sub__rule=allow("@{T}"),
        sub__tunable=profiles(tunable("T", "/inner")),
    )
    assert found.code == "tunable"
    assert "declared after its use at" in found.message
    assert found.message.endswith("policy.xml:1")
    assert "above its use" in found.help


def test_profile_attachment_before_its_tunable(refused) -> None:
    attached = (
        '<profile name="p"><attachment>@{T}</attachment>\n<tunable name="T"><value>/b</value></tunable></profile>'
    )
    found = refused(profiles(tunable("T", "/a"), "\n", attached))
    assert found.code == "tunable"
    assert (found.where.line, "policy.xml:2," in found.message) == (3, True)


def test_uses_in_other_scopes_do_not_matter(load) -> None:
    policy = load(
        profiles(
            tunable("T", "/t"),
            profile(allow("@{T}")),
            profile(tunable("T", "/inner"), allow("@{T}"), attachment="/t"),
            profile(profile(tunable("T", "/a"), allow("@{T}")), tunable("T", "/b"), allow("@{T}")),
        )
    )
    assert topics(policy) == ["/t", "/b", "/a"]
    assert topics(policy, "/t") == ["/inner"]


def test_included_file_sees_the_scope_of_its_include_and_adds_to_it(load) -> None:
    policy = load(
        policy=profiles(
            include("sub/tunables.xml"),
            tunable("T", "/first"),
            profile(include("sub/rule.xml"), attachment="/a"),
            profile(tunable("T", "/second"), include("sub/rule.xml"), attachment="/b"),
            profile(allow("@{SHARED}"), attachment="@{SHARED}"),
        ),
        sub__tunables=profiles(tunable("SHARED", "/shared")),
        sub__rule=allow("@{T}"),
    )
    assert topics(policy, "/a") == ["/first"]
    assert topics(policy, "/b") == ["/second"]
    assert topics(policy, "/shared") == ["/shared"]


def test_scope_ends_with_its_element(refused) -> None:
    found = refused(
        policy=profiles(profile(include("sub/t.xml")), profile(allow("@{T}"))), sub__t=profiles(tunable("T", "x"))
    )
    assert found.code == "tunable"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ((tunable("T", "x"), tunable("T", "x")), "declared twice"),
        ((tunable("T", "a@{T}"),), "refers to itself"),
        ((tunable("T", "x"), profile(tunable("T", "@{T}"))), "refers to itself"),
        ((tunable("A", "@{B}"), tunable("B", "@{A}")), "unknown"),
        ((profile(allow("@{T}")), tunable("T", "x")), "unknown"),
        ((tunable("ROBOT", "x"), profile(allow("@{ROBOTS}"))), "unknown"),
        ((tunable("T", "{oops}"),), "'{oops}' is unknown"),
        ((tunable("T", "\\"),), "lone"),
        ((tunable("T", ""), profile(allow("@{T}"))), "empty"),
        ((tunable("T", "1x"), profile(attachment="/@{T}")), "legal name"),
    ],
)
def test_wrong_tunables(refused, content, message) -> None:
    found = refused(profiles("\n", "\n".join(content)))
    assert message in found.message
    assert found.where.line > 1


def test_unknown_tunable_is_asked_back(refused) -> None:
    assert refused(profiles(tunable("ROBOT", "x"), profile(allow("@{ROBOTS}")))).help == "did you mean 'ROBOT'?"


def test_tunables_cannot_explode(refused) -> None:
    doubling = [tunable(f"T{i}", f"@{{T{i - 1}}}@{{T{i - 1}}}") for i in range(1, 40)]
    found, calls = calls_of(lambda: refused(profiles(tunable("T0", "a", "b"), *doubling)))
    assert found.code == "tunable"
    assert calls < 500_000


def test_unused_tunables(load) -> None:
    policy = load(
        profiles(
            tunable("USED", "/s"),
            tunable("CHAIN", "@{USED}"),
            tunable("SHADOWED", "/x"),
            profile(tunable("SHADOWED", "/y"), allow("@{SHADOWED}"), attachment="@{CHAIN}"),
            tunable("NEVER", "/z"),
        )
    )
    assert [unused.name for unused in policy.unused_tunables] == ["SHADOWED", "NEVER"]


def test_a_tunable_of_an_included_file_is_used_if_one_of_its_includes_uses_it(load) -> None:
    used = profile(include("sub/t.xml"), allow("@{T}"), attachment="/a")
    unused = profile(include("sub/t.xml"), attachment="/b")
    shared = profiles(tunable("T", "/x"), tunable("U", "/y"))
    for order in ((used, unused), (unused, used)):
        policy = load(policy=profiles(*order), sub__t=shared)
        assert [each.name for each in policy.unused_tunables] == ["U"]
