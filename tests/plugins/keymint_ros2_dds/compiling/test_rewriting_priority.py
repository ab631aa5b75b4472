# SPDX-License-Identifier: Apache-2.0
"""What is requested more often comes first, where that changes no decision."""

from __future__ import annotations

from keymint.api import BuildOptions, Hint
from keymint.api.graph import Edge, Object
from tests.plugins.keymint_ros2_dds.emit.test_emission import (
    TOPIC,
    document,
    topics,
)
from tests.plugins.keymint_ros2_dds.packages import package, rule


class TestPriority:
    def hinted(self, *asked: tuple[str, int], permission: str = "ros_publish") -> BuildOptions:
        edges = ((Edge("/talker", permission, Object("ros_topic", name)), times) for name, times in asked)
        return BuildOptions(hints=tuple(Hint(edge, times) for edge, times in edges))

    def test_expressions_stand_by_how_often_they_are_asked_for(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a", "/b", "/c*"))
        assert topics(document(loaded)) == ["rt/a", "rt/b", "rt/c*"]
        hinted = self.hinted(("/b", 1), ("/cat", 2), ("/cow", 3))
        assert topics(document(loaded, hinted)) == ["rt/c*", "rt/b", "rt/a"]

    def test_rules_about_other_partitions_change_places(self) -> None:
        raw = [rule("ALLOW", "topic", "publish", name, partitions=[name]) for name in ("p", "q")]
        loaded = package(*raw)
        hinted = BuildOptions(hints=(Hint(Edge("/talker", "publish", Object("topic", "q", ("q",))), 5),))
        assert topics(document(loaded)) == ["p", "q"]
        assert topics(document(loaded, hinted)) == ["q", "p"]

    def test_a_denial_is_overtaken_by_nothing_that_it_touches(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a*"), rule("DENY", *TOPIC, "/ab"), rule("ALLOW", *TOPIC, "/z"))
        hinted = self.hinted(("/aa", 100))
        assert topics(document(loaded, hinted)) == ["rt/z", "rt/ab", "rt/a*"]

    def test_what_nobody_can_ask_for_is_passed_over(self) -> None:
        loaded = package(rule("ALLOW", *TOPIC, "/a"), distro="ardent")
        edge = Edge("/talker", "ros_request", Object("ros_action", "/fibonacci"))
        assert topics(document(loaded, BuildOptions(hints=(Hint(edge, 1),)))) == ["a"]
