# SPDX-License-Identifier: Apache-2.0
"""The document that SROS2 writes, after the table of its stylesheet."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_sros2.deviations import permissions_document
from keymint_ros2_sros2.parse import parse
from lxml import etree

from .sros2_policies import enclave, policy


def written(path, at: int = 0, *, implicit: bool = True) -> etree._Element:
    found = parse(path)
    content = permissions_document(found.enclaves[at], graph=implicit and found.has_graph)
    dds_xml.require_valid(content, "permissions", "permissions.xml")
    return etree.fromstring(content)


def topics(root: etree._Element, rule: str = "allow_rule") -> dict[str, set[str]]:
    return {
        action: {str(each.text) for each in root.iterfind(f".//{rule}/{action}/topics/topic")}
        for action in ("publish", "subscribe")
    }


GOAL = ("cancel_goal", "get_result", "send_goal")
REQUESTS = {f"rq/x/_action/{each}Request" for each in GOAL}
REPLIES = {f"rr/x/_action/{each}Reply" for each in GOAL}
TOPICS = {"rt/x/_action/feedback", "rt/x/_action/status"}


@pytest.mark.parametrize(
    ("rules", "publish", "subscribe"),
    [
        ('<topics publish="ALLOW"><topic>x</topic></topics>', {"rt/x"}, set()),
        ('<topics subscribe="ALLOW"><topic>x</topic></topics>', set(), {"rt/x"}),
        ('<services request="ALLOW"><service>x</service></services>', {"rq/xRequest"}, {"rr/xReply"}),
        ('<services reply="ALLOW"><service>x</service></services>', {"rr/xReply"}, {"rq/xRequest"}),
        ('<actions call="ALLOW"><action>x</action></actions>', REQUESTS, REPLIES | TOPICS),
        ('<actions execute="ALLOW"><action>x</action></actions>', REPLIES | TOPICS, REQUESTS),
    ],
)
def test_of_each_attribute(write, rules: str, publish: set[str], subscribe: set[str]) -> None:
    path = write(policy(enclave("/e", rules)))
    assert topics(written(path, implicit=False)) == {"publish": publish, "subscribe": subscribe}
    denied = written(write(policy(enclave("/e", rules.replace("ALLOW", "DENY")))), implicit=False)
    assert topics(denied, "deny_rule") == {"publish": publish, "subscribe": subscribe}
    assert denied.find(".//allow_rule") is None


def test_a_denial_comes_first_and_the_graph_last(robot) -> None:
    root = written(robot, 1)
    rules = [each for each in root[0][0] if each.tag.endswith("_rule")]
    assert [each.tag for each in rules] == ["deny_rule", "allow_rule", "allow_rule"]
    assert topics(rules[2], "allow_rule") == {"publish": set(), "subscribe": set()}
    assert {str(each.text) for each in rules[2].iter("topic")} == {"ros_discovery_info"}
    assert root.findtext(".//subject_name") == "CN=/robot/listener"
    assert root.findtext(".//default") == "DENY"


def test_each_profiles_has_its_grant(write) -> None:
    profiles = (
        '<profiles><profile ns="/" node="n"><topics publish="ALLOW"><topic>t</topic></topics></profile></profiles>'
    )
    root = written(write(policy(f'<enclave path="/a">{profiles * 2}</enclave>')))
    assert len(root.findall(".//grant")) == 2


def test_names_are_those_that_are_enforced(write) -> None:
    rules = '<topics publish="ALLOW"><topic>~x</topic><topic> y </topic></topics>'
    root = written(write(policy(enclave("/a", rules, ns="/ns"))), implicit=False)
    assert topics(root)["publish"] == {"rt/ns/nx", "rt/ns/ y "}


def test_version_0_1_0_has_no_graph(write) -> None:
    profile = '<profile ns="/ns" node="n"><topics publish="ALLOW"><topic>t</topic></topics></profile>'
    root = written(write(f'<policy version="0.1.0"><profiles>{profile}</profiles></policy>'))
    assert {str(each.text) for each in root.iter("topic")} == {"rt/ns/t"}
    assert root.findtext(".//subject_name") == "CN=/ns/n"
