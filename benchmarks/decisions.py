# SPDX-License-Identifier: Apache-2.0
"""Measure decisions per second of a policy: one by one, and by rows. ``verify.py`` measures those of transports.

usage: python benchmarks/decisions.py [--edges N] [--policy PATH]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from itertools import chain, cycle, islice
from pathlib import Path

from keymint_ros.distros import library
from keymint_ros2_comarmor import policy_type

from comarmor.errors import Origin
from keymint.api import PolicySource
from keymint.api.graph import Edge, Graph, Object, complete

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def objects(subjects: Iterable[str]) -> list[Object]:
    """Return objects, few of them allowed."""
    names = ["/chatter", "/rosout", "/clock", "/parameter_events", "/tf", "/scan", "/map", "/odom", "/cmd_vel"]
    services = [f"{subject}/{verb}_parameters" for subject in subjects for verb in ("get", "set", "list")]
    return [Object("ros_topic", name) for name in names] + [Object("ros_service", name) for name in services]


def rate(edges: list[Edge], decisions: Iterable[object]) -> float:
    """Return the number of decisions per second."""
    begin = time.perf_counter()
    count = sum(1 for _ in decisions)
    elapsed = time.perf_counter() - begin
    if count != len(edges):
        raise SystemExit(f"{count} decisions on {len(edges)} edges")
    return count / elapsed


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edges", type=int, default=10_000)
    parser.add_argument("--policy", type=Path, default=EXAMPLES / "talker_listener")
    options = parser.parse_args()
    source = PolicySource("policy", options.policy.resolve(), Origin("benchmark"))
    policy = policy_type.load([source], library("jazzy"))
    subjects = sorted(policy.subjects())
    ends = [
        Edge(subject, "ros_publish" if each.kind == "ros_topic" else "ros_call", each)
        for subject in subjects
        for each in objects(subjects)
    ]
    edges = sorted(islice(cycle(complete(Graph.of(ends))), options.edges))
    base = rate(edges, map(policy.decide, edges))
    print(f"{'policy':24} {base:10,.0f}/s   1.00   {len(edges)} edges of {len(subjects)} subjects")
    by_rows: dict[tuple[str, str, str], list[str]] = {}
    for edge in edges:
        by_rows.setdefault((edge.subject, edge.object.kind, edge.permission), []).append(edge.object.name)
    in_rows = rate(edges, chain.from_iterable(policy.allowed(*row, names) for row, names in by_rows.items()))
    print(f"{'policy, by rows':24} {in_rows:10,.0f}/s {in_rows / base:6.2f}")


if __name__ == "__main__":
    main()
