# SPDX-License-Identifier: Apache-2.0
"""Channels by which data can flow between subjects."""

from __future__ import annotations

from pathlib import Path

from comarmor.patterns.glob import parse
from keymint.analysis.channels import ChannelSearch
from tests.keymint.analysis.policies import loaded, profile, rule

PUB = ("ros_topic", "ros_publish")


SUB = ("ros_topic", "ros_subscribe")


def test_channels(tmp_path: Path) -> None:
    policy = loaded(
        tmp_path,
        profile("/a", rule(*PUB, "/x/*")),
        profile("/b", rule(*SUB, "/x/y"), rule("ros_service", "ros_call", "/s")),
        profile("/c", rule("ros_service", "ros_execute", "/s")),
    )
    path = ChannelSearch(policy, ()).path(["/a"], ["/c"])
    assert path is not None
    assert [(step.writer, step.reader, step.word) for step in path] == [("/a", "/b", "/x/y"), ("/b", "/c", "/s")]
    # A server answers its clients.
    assert len(ChannelSearch(policy, ()).path(["/c"], ["/b"]) or ()) == 1
    assert ChannelSearch(policy, ()).path(["/c"], ["/a"]) is None
    assert ChannelSearch(policy, ["/x/*"]).path(["/a"], ["/c"]) is None


def test_a_source_that_is_a_target(tmp_path: Path) -> None:
    both = rule("ros_topic", "ros_publish ros_subscribe", "/loop")
    policy = loaded(
        tmp_path,
        profile("/a", both),
        profile("/b", both, rule(*SUB, "/x")),
        profile("/c", rule(*PUB, "/x"), rule(*SUB, "/y")),
        profile("/d", rule(*PUB, "/y")),
    )
    channels = ChannelSearch(policy, ())
    assert len(channels.path(["/a", "/c"], ["/a"]) or ()) == 2
    # /a reaches /b first, and comes back to itself; the path from /d is longer, but it is a path.
    assert [step.writer for step in channels.path(["/a", "/d"], ["/a"]) or ()] == ["/d", "/c", "/b"]
    assert channels.path(["/a"], ["/a"]) is None
    assert channels.path(["/a", "/b"], ["/d"]) is None


def test_channels_of_unnamed_subjects(tmp_path: Path) -> None:
    policy = loaded(tmp_path, profile("/amr*/*", rule("ros_topic", "ros_publish ros_subscribe", "{namespace}*")))
    channels = ChannelSearch(policy, ())
    assert list(channels.possible(parse("/amr1/*"), parse("/amr2/*"))) == []
    assert list(channels.possible(parse("/amr1/*"), parse("/amr*/*"))) != []
