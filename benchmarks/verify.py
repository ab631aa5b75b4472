# SPDX-License-Identifier: Apache-2.0
"""Measure how the time and memory of verify grow with subjects and objects, for all edges of the completion.

usage: python benchmarks/verify.py [--sizes 25x250,50x500,100x1000,200x2000] [--transport NAME]...

For each size, it provisions a policy on tmpfs, and verifies the completion of a graph that names every subject and
object, in a process of its own, at the tier ``decision``. Seconds are processor time; peak memory is that of the
process. Expect a constant cost per edge, and memory that grows by about a byte per edge plus the names.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from fleet import KEYMINT, ROLES, policy, spent


def graph(subjects: int, objects: int) -> str:
    """Return a graph in which a tenth of the objects are services."""
    edges = []
    for number in range(objects):
        n, serial = number % subjects, number // subjects
        permission, name = ("ros_execute", "/serve") if serial % 10 == 0 else ("ros_publish", "/data")
        subject = f"/robot{n // 2}/{ROLES[n % 2][0]}"
        edges.append({"subject": subject, "permission": permission, "object": f"{name}/n{n}_{serial}"})
    return json.dumps({"format": "keymint-graph", "version": 1, "edges": edges})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="25x250,50x500,100x1000,200x2000", help="SUBJECTSxOBJECTS,…")
    parser.add_argument("--transport", action="append", help="measure only this one; may be repeated")
    options = parser.parse_args()
    chosen = options.transport or ["omg", "cyclonedds-0.10", "fastdds-2.9"]
    print(f"{'size':>10} {'transport':>16} {'edges':>9} {'errors':>7} {'seconds':>8} {'us/edge':>8} {'peak MB':>8}")
    for size in options.sizes.split(","):
        subjects, objects = map(int, size.split("x"))
        with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
            root = Path(folder)
            (root / "policy.xml").write_text(policy(subjects, own=True))
            (root / "graph.json").write_text(graph(subjects, objects))
            spent(*KEYMINT, "provision", "policy.xml", "-w", "ws", "-q", cwd=root)
            for transport in chosen:
                words = ("verify", "-w", "ws", "--graph", "graph.json", "-t", transport, "--json")
                took = spent(*KEYMINT, *words, cwd=root, codes=(0, 3))
                result = json.loads(took.out)["result"]
                (outcome,) = result["transports"]
                counts, edges = outcome["confusion"], result["edges"]
                errors = counts["false_positive"] + counts["false_negative"]
                cost = took.cpu / edges * 1e6
                spending = f"{took.cpu:>8.1f} {cost:>8.1f} {took.memory:>8.0f}"
                print(f"{size:>10} {transport:>16} {edges:>9} {errors:>7} {spending}")


if __name__ == "__main__":
    main()
