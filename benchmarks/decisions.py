# SPDX-License-Identifier: Apache-2.0
"""Measure decisions per second of the policy, the simulated transports and the real vendors, relative to the policy.

usage: python benchmarks/decisions.py [--edges N] [--policy PATH]
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from itertools import chain, cycle, islice
from pathlib import Path

from fleet import KEYMINT, spent

from comarmor.errors import Origin
from keymint.api import Enclave, Environment, PolicySource, Tier
from keymint.graph import Edge, Graph, Object, complete
from keymint.plugins import Plugins

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
    with tempfile.TemporaryDirectory() as scratch:
        workspace = Path(scratch) / "ws"
        spent(*KEYMINT, "provision", str(options.policy), "-w", str(workspace), "-q")
        root = workspace / "install" / "enclaves"
        enclaves = [
            Enclave(f"/{path.parent.relative_to(root)}", path.parent, "humble", root) for path in root.rglob("cert.pem")
        ]
        plugins = Plugins(environment=Environment(datetime.now(UTC), Path(scratch) / "cache", dict(os.environ)))
        subjects = sorted(enclave.subject for enclave in enclaves)
        ends = [
            Edge(subject, "ros_publish" if each.kind == "ros_topic" else "ros_call", each)
            for subject in subjects
            for each in objects(subjects)
        ]
        edges = sorted(islice(cycle(complete(Graph.of(ends))), options.edges))
        source = PolicySource("policy", options.policy.resolve(), Origin("benchmark"))
        policy = plugins.policy_type("keymint_ros2_comarmor").load([source], workspace / "profile" / "comarmor.d")
        base = rate(edges, map(policy.decide, edges))
        print(f"{'policy':24} {base:10,.0f}/s   1.00   {len(edges)} edges of {len(subjects)} subjects")
        by_rows: dict[tuple[str, str, str], list[str]] = {}
        for edge in edges:
            by_rows.setdefault((edge.subject, edge.object.kind, edge.permission), []).append(edge.object.name)
        in_rows = rate(edges, chain.from_iterable(policy.allowed(*row, names) for row, names in by_rows.items()))
        print(f"{'policy, by rows':24} {in_rows:10,.0f}/s {in_rows / base:6.2f}")
        for name in plugins.transports_of("keymint_ros2_dds"):
            transport = plugins.transport(name)
            usable = transport.usable()
            if not usable.usable:
                print(f"{name:24} not usable: {usable.reason}")
                continue
            list(transport.label(enclaves, edges[:1], Tier.DECISION))  # builds the vendor's programs
            speed = rate(edges, transport.label(enclaves, iter(edges), Tier.DECISION))
            print(f"{name:24} {speed:10,.0f}/s {speed / base:6.2f}")


if __name__ == "__main__":
    main()
