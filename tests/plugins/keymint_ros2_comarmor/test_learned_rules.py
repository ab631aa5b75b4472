# SPDX-License-Identifier: Apache-2.0
"""Needs of subjects are merged, and folded into rules that grant exactly them."""

from __future__ import annotations

from hypothesis import given, strategies as st
from keymint_ros2_comarmor.policy_documents import fold, literal, needs_of, templates

from comarmor.language.attachments import expand, for_parts, parse, parts
from comarmor.patterns.expression import literal as only_name
from comarmor.rules import PERMISSIONS, Effect
from keymint.api.graph import Edge, Object

NEEDS = st.lists(
    st.sampled_from([(kind, permission) for kind, all_ in PERMISSIONS.items() for permission in all_]).flatmap(
        lambda held: st.tuples(
            st.just(held[0]),
            st.sampled_from(["/a", "/b*", "x"]),
            st.just(held[1]),
            st.sampled_from([(), ("", "p"), ("p*",)]) if held[0] == "topic" else st.just(()),
        )
    ),
    max_size=10,
)


def test_partitions_of_one_permission_are_merged_and_the_default_one_alone_is_none() -> None:
    topic = [Object("topic", "t", partitions) for partitions in ((), ("b", "a"), ("c",))]
    edges = [Edge("/s", "publish", each) for each in topic] + [Edge("/s", "subscribe", topic[0], 7)]
    assert needs_of(edges) == {"/s": {("topic", "t", "publish", ("", "a", "b", "c")), ("topic", "t", "subscribe", ())}}


@given(NEEDS)
def test_folded_rules_grant_each_need_once_and_nothing_else(needs) -> None:
    rules = fold(needs)
    granted = [
        (rule.kind, attachment.text, permission, rule.partitions)
        for rule in rules
        for attachment in rule.attachments
        for permission in rule.permissions
    ]
    assert sorted(granted) == sorted(set(needs))
    assert fold(reversed(needs)) == rules
    assert all(rule.permissions == tuple(p for p in PERMISSIONS[rule.kind] if p in rule.permissions) for rule in rules)
    groups = [(rule.kind, rule.permissions, rule.partitions) for rule in rules]
    assert len(set(groups)) == len(groups)


@given(
    st.sampled_from(["/a", "/ns/a", "/ns/b*/c"]),
    st.sampled_from(["/t", "/a/x", "/ns/a", "/ns/a/x", "/ns/ab", "/ns/b*/c/[x]", "/ns/{name}"]),
    st.sampled_from([("ros_topic", "ros_publish"), ("topic", "publish")]),
)
def test_every_template_of_a_need_names_its_object_for_its_subject(subject, name, held) -> None:
    need = (held[0], name, held[1], ())
    shared = templates(need, subject)
    assert shared[0] == literal(need)
    for kind, text, permission, partitions in shared:
        (value,) = expand(parse(text), lambda _: ())
        assert only_name(for_parts(value, *parts(subject))) == name
        assert (kind, permission, partitions) == (need[0], need[2], need[3])


def test_the_partitions_of_a_need_are_names() -> None:
    need = ("topic", "t*", "publish", ("", "p*"))
    assert literal(need) == ("topic", "t\\*", "publish", ("", "p\\*"))
    assert templates(need, "/a") == (literal(need),)


def test_rules_may_deny() -> None:
    (rule,) = fold([("topic", "t*", "publish", ("p*",))], Effect.DENY)
    assert (rule.effect, rule.partitions, rule.attachments[0].text) == (Effect.DENY, ("p*",), "t*")


def test_names_below_the_subject_or_its_namespace_may_be_shared() -> None:
    def texts(kind: str, name: str, subject: str) -> list[str]:
        return [template[1] for template in templates((kind, name, "p", ()), subject)]

    assert texts("ros_topic", "/ns/a/x", "/ns/a") == ["/ns/a/x", "{namespace}{name}/x"]
    assert texts("ros_topic", "/ns/ab", "/ns/a") == ["/ns/ab", "{namespace}ab"]
    assert texts("ros_topic", "/t", "/a") == ["/t"]
    assert texts("topic", "/ns/a/x", "/ns/a") == ["/ns/a/x"]
