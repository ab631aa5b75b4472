# SPDX-License-Identifier: Apache-2.0
"""Needs that several subjects share move into included files, where that makes the policy shorter."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
from keymint_ros2_comarmor.policy_documents import share, templates

SUBJECTS = ["/a", "/b", "/ns/a", "/ns/b"]
NAMES = [f"{root}/{'long_name_' * 4}{number}" for root in ("", "/a", "/ns", "/ns/a") for number in range(3)]
NEEDS = st.dictionaries(
    st.sampled_from(SUBJECTS),
    st.sets(st.sampled_from([("ros_topic", name, "ros_publish", ()) for name in NAMES])),
)


@settings(deadline=None)
@given(NEEDS)
def test_a_common_part_covers_the_same_templates_for_each_subject_that_includes_it(needs) -> None:
    parts = share(needs)
    for part in parts:
        assert len(part.covered) > 1
        for subject, covered in part.covered.items():
            assert covered <= needs[subject]
            assert len(covered) == len(part.needs)
            assert all(part.needs & set(templates(need, subject)) for need in covered)
    for subject in needs:
        listed = [need for part in parts for need in part.covered.get(subject, ())]
        assert len(set(listed)) == len(listed)
    assert [part.name for part in parts] == [f"common_{number}.xml" for number in range(1, len(parts) + 1)]


def test_one_attachment_is_not_worth_a_file_and_a_rule_is() -> None:
    little = {("ros_topic", "/topic_of_both_nodes", "ros_publish", ())}
    much = {("ros_topic", f"/{'long_name_' * 4}{number}", "ros_publish", ()) for number in range(10)}
    assert len(share({"/a": little, "/b": little})) == 1
    own = {("ros_topic", "/own", "ros_publish", ())}  # the rule stays, so that only one attachment would move
    assert share({"/a": little | own, "/b": little | {("ros_topic", "/other", "ros_publish", ())}}) == ()
    (part,) = share({"/a": much | little, "/b": much})
    assert (tuple(part.covered), part.needs) == (("/a", "/b"), frozenset(much))
    assert share({"/a": much, "/b": little}) == ()
