# SPDX-License-Identifier: Apache-2.0
"""A loaded policy: the profiles and rules that apply to a subject, and the subjects that it names."""

from __future__ import annotations

from hypothesis import given, strategies as st

from comarmor import Attachment, Origin, Policy, Profile
from comarmor.patterns.glob import matches, parse
from tests.effort import calls_of

from .policies import allow, include, profile, profiles, rule


def test_a_thousand_profiles_load_and_are_looked_up_quickly(load) -> None:
    many = "".join(profile(*(allow(f"/t{i}/{j}") for j in range(10)), attachment=f"/r/p{i}") for i in range(1000))
    policy = load(profiles(many, profile(attachment="*")))
    subjects = policy.subjects()
    rules, calls = calls_of(lambda: sum(len(policy.rules(subject)) for subject in subjects))
    assert rules == 10_000
    assert calls < 200 * rules


def test_rules_of_several_profiles_are_one_set(load) -> None:
    policy = load(
        f"<profiles>{profile(rule('ros_topic', 'ALLOW', '/x', 'ros_publish'))}"
        f"{profile(rule('ros_topic', 'DENY', '/x*', 'ros_publish'), attachment='*')}</profiles>"
    )
    assert [len(policy.rules(subject)) for subject in ("/s", "/t")] == [2, 1]
    assert not policy.decide("/s", "ros_topic", "ros_publish", "/x").allowed


def test_nested_profile_applies_only_where_every_outer_one_does(load) -> None:
    inner = profile(rule("ros_topic", "ALLOW", "/x", "ros_publish"), attachment="*/arm")
    exact = profile(attachment="/r2/base")
    policy = load(profile(inner, exact, profile(attachment="/r1/base"), attachment="/r1/*"))
    assert policy.decide("/r1/arm", "ros_topic", "ros_publish", "/x").allowed
    assert not policy.decide("/r2/arm", "ros_topic", "ros_publish", "/x").allowed
    assert policy.subjects() == ("/r1/base",)
    assert [p.attachments[0].text for p in policy.applicable("/r1/arm")] == ["/r1/*", "*/arm"]


def test_profile_with_attachments_alone_is_a_subject(load) -> None:
    policy = load(profile(attachment="/only/keys"))
    assert policy.subjects() == ("/only/keys",)
    assert policy.rules("/only/keys") == ()
    assert len(policy.applicable("/only/keys")) == 1


def test_audit_of_a_profile_marks_every_rule_below(load) -> None:
    plain = rule("ros_topic", "ALLOW", "/x", "ros_publish")
    own = rule("ros_topic", "ALLOW", "/y", "ros_publish", modifier=' modifier="AUDIT"')
    watched = profile(profile(plain), attributes=' modifier="AUDIT"')
    policy = load(f"<profiles>{watched}{profile(own, plain)}</profiles>")
    assert [found.audit for found in policy.rules("/s")] == [True, True, False]


def test_rules_are_expanded_for_each_subject_and_shared_between_those_they_do_not_depend_on(load) -> None:
    policy = load(profile(allow("/{name}"), allow("/fixed"), attachment="*"))
    (own_a, fixed_a), (own_b, fixed_b) = policy.rules("/r/a"), policy.rules("/r/b")
    assert (own_a.expressions, own_b.expressions) == (("/a",), ("/b",))
    assert fixed_a is fixed_b
    assert policy.rules("/r/a") == (own_a, fixed_a)


def test_a_profile_with_several_matching_attachments_applies_once(load) -> None:
    policy = load(profile("<attachment>/r/*</attachment>", "<attachment>*/a</attachment>", attachment="/r/a"))
    assert len(policy.applicable("/r/a")) == 1
    assert len(policy.applicable("/r/b")) == 1
    assert policy.applicable("/") == ()


ATTACHMENTS = st.sampled_from(["/a", "/b", "/a/b", "*", "/*", "/a*", "*/b", "/?", "/[ab]", "/a/[!b]", "?a", ""])


@given(st.lists(st.lists(ATTACHMENTS, min_size=1, max_size=3), max_size=5), st.text("/abc", max_size=4))
def test_a_profile_applies_to_the_subjects_that_one_of_its_attachments_matches(texts, subject) -> None:
    where = Origin("generated.xml", 1)
    profiles_ = tuple(
        Profile(str(number), False, tuple(Attachment(text, where) for text in each), (), (), where)
        for number, each in enumerate(texts)
    )
    expected = [str(number) for number, each in enumerate(texts) if any(matches(parse(t), subject) for t in each)]
    assert [profile_.name for profile_ in Policy(profiles_).applicable(subject)] == expected


def test_the_digest_of_a_subjects_rules_differs_with_them_and_not_with_their_lines(load) -> None:
    def digest_of(*own: str, after: str = "", before: str = "", included: str = "/common", audit: str = "") -> str:
        text = profiles(before, profile(*own, include("own/more.xml"), attributes=audit), after)
        part = {"own__more": profiles(include("part.xml")), "own__part": allow(included, "{name}")}
        return load(policy=text, **part).rules_digest("/s")

    other = profile(allow("/other"), attachment="/t")
    same = digest_of(allow("/x", "/y"))
    assert same
    assert digest_of(allow("/x", "/y"), after=other) == digest_of(allow("/x", "/y"), before=other) == same
    different = {
        digest_of(allow("/x")),
        digest_of(allow("/x"), allow("/y")),
        digest_of(allow("/x", "/y"), included="/changed"),
        digest_of(allow("/x", "/y"), audit=' modifier="AUDIT"'),
        digest_of(allow("/x", "/y"), after=profile(allow("/z"), attachment="*")),
        digest_of(rule("ros_topic", "DENY", "/x", "ros_publish")),
        digest_of(rule("ros_topic", "ALLOW", "/x", "ros_subscribe")),
        digest_of(rule("topic", "ALLOW", "/x", "publish", partitions=[])),
        digest_of(rule("topic", "ALLOW", "/x", "publish", partitions=[""])),
        same,
    }
    assert len(different) == 10
    assert digest_of(allow("/x", "/y"), before="\n") == same
    assert load(profile(attachment="/t")).rules_digest("/s") is None


def test_alike_subjects_have_digests_of_their_own(load) -> None:
    policy = load(profile(allow("{name}"), attachment="/r/*"))
    assert policy.rules_digest("/r/a") != policy.rules_digest("/r/b")
