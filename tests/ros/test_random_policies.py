# SPDX-License-Identifier: Apache-2.0
"""What nodes of ROS may do is what ``keymint test`` and ``keymint verify`` say, for random policies."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from tests.effort import tries

from .random_policies import OPERATIONS, SUBJECTS, operations, random_policy
from .ros_system import RosSystem, answered, delivered, expectations, kept, tried

SEEDS = range(tries(6, 22))


@pytest.mark.parametrize("seed", SEEDS)
def test_nodes_may_do_what_test_and_verify_say(ros: RosSystem, counts: Counter[str], seed: int) -> None:
    install = ros.provision(random_policy(seed))
    answers = []
    for subject in SUBJECTS:
        node = ros.node(install, subject)
        answers += [(subject, each, name, tried(node, each, name)) for each, name in operations(seed, subject)]
        node.reap()
    assert len(answers) == len(SUBJECTS) * OPERATIONS
    assert {allowed for *_, allowed in answers} == {False, True}
    (ros.folder / "ws.test.xml").write_text(expectations(answers))
    ros.keymint("test", ros.folder / "ws.xml")
    (ros.folder / "graph.json").write_text(json.dumps(graph(answers)))
    by_model = json.loads(
        ros.keymint(
            "verify", "-w", ros.folder / "ws", "-i", "omg", "-i", "cyclonedds-0.10", "-i", "fastdds-2.9", "--graph",
            ros.folder / "graph.json", "--json",
        )
    )  # fmt: skip
    assert all(not each["findings"] for each in by_model["result"]["transports"])
    counts["operations of random policies, as 'keymint test' and 'keymint verify' say"] += len(answers)
    counts["  of which allowed"] += sum(allowed for *_, allowed in answers)


def graph(answers: list[tuple[str, str, str, bool]]) -> dict[str, object]:
    """Return the graph of what was tried."""
    edges = [{"subject": subject, "permission": each, "object": name} for subject, each, name, _ in answers]
    return {"format": "keymint-graph", "version": 1, "edges": edges}


@pytest.mark.parametrize("seed", range(tries(2, 6)))
def test_verify_ros_agrees(ros: RosSystem, counts: Counter[str], seed: int) -> None:
    ros.provision(random_policy(seed))
    result = json.loads(ros.keymint("verify", "-w", ros.folder / "ws", "--ros", "--json"))["result"]
    confusion = result["transports"][0]["confusion"]
    assert confusion["false_positive"] == confusion["false_negative"] == 0
    assert confusion["true_positive"] >= 20
    assert confusion["true_negative"] >= 20
    assert sum(each["asked"] for each in result["operations"]) == result["edges"] == sum(confusion.values())
    assert all(each["asked"] == each["agreed"] for each in result["operations"])
    assert sum(each["count"] for each in result["denials"]) == confusion["true_negative"]
    counts["rights and near misses that 'verify --ros' tried of random policies, all as the policy says"] += result[
        "edges"
    ]


@pytest.mark.parametrize("seed", range(100, 100 + tries(2, 6)))
def test_what_is_allowed_at_both_ends_is_delivered(ros: RosSystem, counts: Counter[str], seed: int) -> None:
    """And what is denied at one end is not even created there."""
    install: Path = ros.provision(random_policy(seed))
    answers = []
    for permission, other, arrives, names in (
        ("ros_publish", "ros_subscribe", delivered, ("/scan", "/r1/scan", "/r1/odom")),
        ("ros_call", "ros_execute", answered, ("/scan", "/r1/scan", "/r1/odom")),
        ("ros_request", "ros_operate", answered, ("/r1/scan", "/r1/odom")),
    ):
        ends = {each: (ros.node(install, each), ros.node(install, each)) for each in SUBJECTS}
        for name in names:
            senders = [subject for subject, (node, _) in ends.items() if tried(node, permission, name)]
            receivers = [subject for subject, (_, node) in ends.items() if tried(node, other, name)]
            answers += [(each, permission, name, each in senders) for each in SUBJECTS]
            answers += [(each, other, name, each in receivers) for each in SUBJECTS]
            counts["pairs of enclaves of which ROS and the policy deny one end"] += len(SUBJECTS) ** 2 - len(
                senders
            ) * len(receivers)
            for sender in senders:
                for receiver in receivers:
                    one, two = ros.node(install, sender), ros.node(install, receiver)
                    kept(one, "out", permission, name)
                    kept(two, "in", other, name)
                    assert arrives(one, two, 60.0), (sender, receiver, permission, name)
                    counts["deliveries that the policy allows, all delivered"] += 1
                    one.reap()
                    two.reap()
        for one, two in ends.values():
            one.reap()
            two.reap()
    (ros.folder / "ws.test.xml").write_text(expectations(answers))
    ros.keymint("test", ros.folder / "ws.xml")
