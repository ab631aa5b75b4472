# SPDX-License-Identifier: Apache-2.0
"""The lists of partitions in which topic patterns are allowed."""

from __future__ import annotations

import pytest

from tests.plugins.keymint_ros2_dds.builds import CHATTER, LENIENT, build, codes, permissions, refusal
from tests.plugins.keymint_ros2_dds.packages import rule


def test_partitions():
    document = permissions(
        rule("ALLOW", "topic", "publish", "a", "b*", partitions=["p", ""]),
        rule("ALLOW", "topic", "publish", "b1", partitions=["q"]),
        rule("DENY", "topic", "publish", "a", partitions=["p"]),
    )
    found = [
        ([t.text for t in each.find("topics")], [p.text or "" for p in each.iterfind("partitions/partition")])
        for each in document.iter("publish")
    ]
    assert found == [(["a"], []), (["b1"], ["", "p", "q"]), (["b*"], ["", "p"])]


def test_a_denial_under_a_wildcard_with_partitions_is_about_every_partition():
    document = permissions(
        rule("ALLOW", "topic", "publish", "*", partitions=["*"]), rule("DENY", "topic", "publish", "secret")
    )
    assert [p.text for p in document.find("permissions/grant/deny_rule/publish/partitions")] == ["*"]


@pytest.mark.parametrize("listed", [["p?"], ["[pq]"], ["caf\xe9"], [r"p\*"]])
def test_partitions_that_vendors_read_differently_are_refused(listed):
    bad = rule("ALLOW", "topic", "publish", "x", partitions=listed, line=12)
    (found,) = refusal(CHATTER, bad)
    assert (found.code, str(found.where)) == ("portability-partition", "policy.xml:12")
    assert codes(build(bad, options=LENIENT).diagnostics) == ["portability-partition"]
