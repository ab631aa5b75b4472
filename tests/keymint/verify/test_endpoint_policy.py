# SPDX-License-Identifier: Apache-2.0
"""What a policy means on endpoints: rules on ROS names and on DDS names meet there."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_comarmor import policy_type
from keymint_ros2_dds import build_type

from comarmor.errors import Origin
from keymint.api import LoadedPolicy, PolicySource
from keymint.api.graph import LABELLED, Column, Edge, Object
from keymint.verify.endpoint_policy import EdgeRow, EndpointPolicy, Naming, label

RULES = """
<ros_topic qualifier="ALLOW"><attachment>/a</attachment><attachment>/b*</attachment>
  <permissions><ros_publish/></permissions></ros_topic>
<topic qualifier="DENY"><attachment>rt/b_secret</attachment><permissions><publish/></permissions></topic>
<topic qualifier="ALLOW"><attachment>rt/raw</attachment><permissions><publish/></permissions></topic>
<topic qualifier="ALLOW"><attachment>rq/sRequest</attachment><permissions><publish/></permissions></topic>
<topic qualifier="ALLOW"><attachment>rr/sReply</attachment><permissions><subscribe/></permissions></topic>
<topic qualifier="ALLOW"><attachment>rq/halfRequest</attachment><permissions><publish/></permissions></topic>
<ros_action qualifier="ALLOW"><attachment>/move</attachment><attachment>/stay</attachment>
  <permissions><ros_request/></permissions></ros_action>
<topic qualifier="DENY"><attachment>rt/stay/_action/status</attachment><permissions><subscribe/></permissions></topic>
"""


@pytest.fixture
def policy(tmp_path: Path) -> LoadedPolicy:
    path = tmp_path / "policy.xml"
    path.write_text(f"<profiles><profile name='s'><attachment>/s</attachment>{RULES}</profile></profiles>")
    return policy_type.load([PolicySource("policy", path, Origin("test"))], None)


@pytest.fixture
def judge(policy: LoadedPolicy) -> EndpointPolicy:
    return EndpointPolicy(policy, {"/s": Naming(build_type.names, "humble")})


def edge(permission: str, name: str, partitions: tuple[str, ...] = ()) -> Edge:
    kind = next(kind for kind, permissions in LABELLED.items() if permission in permissions)
    return Edge("/s", permission, Object(kind, name, partitions))


@pytest.mark.parametrize(
    ("request_", "allowed"),
    [
        (("ros_publish", "/a"), True),
        (("ros_subscribe", "/a"), False),
        (("publish", "rt/a"), True),
        (("publish", "rt/a", ("p",)), False),
        (("ros_publish", "/b1"), True),
        (("ros_publish", "/b_secret"), False),
        (("publish", "rt/b_secret"), False),
        (("ros_publish", "/raw"), True),
        (("ros_call", "/s"), True),
        (("ros_call", "/half"), False),
        (("ros_execute", "/s"), False),
        (("ros_request", "/move"), True),
        (("ros_request", "/stay"), False),
        (("subscribe", "rt/move/_action/status"), True),
        (("publish", "nothing"), False),
    ],
)
def test_deny_first_whoever_says_it(judge: EndpointPolicy, request_: tuple, allowed: bool) -> None:
    assert judge.decide(edge(*request_)).allowed is allowed


def test_the_rule_that_decides_is_named(judge: EndpointPolicy) -> None:
    denied = judge.decide(edge("ros_publish", "/b_secret"))
    assert denied.where
    assert denied.where.line == RULES.split("rt/b_secret", maxsplit=1)[0].count("\n") + 1
    assert judge.decide(edge("ros_call", "/half")).where is None


def test_without_a_naming_names_are_taken_as_they_are(policy: LoadedPolicy) -> None:
    assert not EndpointPolicy(policy, {}).decide(edge("publish", "rt/a")).allowed


def test_labels_are_a_byte_for_each_edge(judge: EndpointPolicy) -> None:
    done: list[str] = []
    row = EdgeRow("/s", Column((edge("ros_publish", "/a"), edge("ros_publish", "/z"), edge("ros_call", "/s"))))
    assert label(judge, [row], done.append) == bytes([1, 0, 1])
    assert done == ["/s"]
