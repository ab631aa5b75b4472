# SPDX-License-Identifier: Apache-2.0
"""Measure the cost of provisioning N enclaves, relative to bare ``cryptography`` calls, and of a run without changes.

usage: python benchmarks/provision.py [--sizes 10,100,1000] [--repeat 3]

Both work on tmpfs and run one after the other, so that noise affects both. The best repeat counts. Seconds are
processor time (user and system, including children), so other work on the machine does not count. Compare the ratios.
"""

from __future__ import annotations

import argparse
import functools
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import floor

KEYMINT = (sys.executable, "-m", "keymint")
PROFILE = """  <profile name="robot{n}">
    <attachment>/robot{n}/talker</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>{{namespace}}chatter*</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
    <ros_topic qualifier="DENY">
      <attachment>{{namespace}}chatter_private</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
    <ros_service qualifier="ALLOW">
      <attachment>/fleet/report</attachment>
      <permissions><ros_call/></permissions>
    </ros_service>
  </profile>
"""


def policy(size: int) -> str:
    """Return a policy that names ``size`` subjects exactly."""
    profiles = "".join(PROFILE.format(n=n) for n in range(size))
    return f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude">\n{profiles}</profiles>\n'


def spent() -> float:
    """Return the processor time of this process and its children in seconds."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def timed(function: Callable[[], object]) -> float:
    """Return the processor time of a call in seconds."""
    start = spent()
    function()
    return spent() - start


def run(*arguments: str) -> None:
    """Run a keymint command; a failure ends the benchmark."""
    subprocess.run([*KEYMINT, *arguments], check=True, stdout=subprocess.DEVNULL)


def measure(size: int, repeat: int, scratch: Path) -> tuple[float, float, float, float]:
    """Return the best seconds of the floor, a first run with and without proofs, and a run without changes."""
    best = [float("inf")] * 4
    for attempt in range(repeat):
        folder = scratch / f"{size}-{attempt}"
        folder.mkdir()
        source = folder / "policy.xml"
        source.write_text(policy(size))
        workspace = str(folder / "ws")
        provision = functools.partial(run, "provision", str(source), "-w", workspace, "-q")
        first, again = timed(provision), timed(provision)
        unproven = str(folder / "unproven")
        bare = timed(functools.partial(run, "provision", str(source), "-w", unproven, "-q", "--no-prove"))
        enclave = folder / "ws/install/enclaves/robot0/talker"
        permissions = (enclave / "permissions.xml").read_bytes()
        governance = (folder / "ws/build/robot0/talker/governance.xml").read_bytes()
        names = [f"robot{n}/talker" for n in range(size)]
        bottom = timed(functools.partial(floor.provision, folder / "floor", names, permissions, governance))
        best = [min(old, new) for old, new in zip(best, (bottom, first, bare, again), strict=True)]
        shutil.rmtree(folder)
    return best[0], best[1], best[2], best[3]


def median_of(command: list[str], repeat: int = 15) -> float:
    """Return the median wall-clock time of a command in seconds."""

    def waited() -> float:
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - start

    return statistics.median(waited() for _ in range(repeat))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="10,100,1000")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    tmpfs = Path("/dev/shm")
    results = []
    heads = ("floor/N", "first/N", "first/floor", "unproven", "again/first")
    print(f"{'N':>6} {heads[0]:>10} {heads[1]:>10} {heads[2]:>12} {heads[3]:>12} {heads[4]:>12}")
    with tempfile.TemporaryDirectory(dir=tmpfs if tmpfs.is_dir() else None) as scratch:
        for size in map(int, options.sizes.split(",")):
            bottom, first, bare, again = measure(size, options.repeat, Path(scratch))
            results.append((size, bottom, first, bare))
            per = [f"{seconds / size * 1e3:8.2f}ms" for seconds in (bottom, first)]
            ratios = (first / bottom, bare / bottom, again / first)
            print(f"{size:>6} {per[0]:>10} {per[1]:>10}", *(f"{ratio:>12.2f}" for ratio in ratios), flush=True)
    if len(results) > 1:
        (small, *low), (large, *high) = results[-2:]
        floor_cost, cost, unproven = ((late - early) / (large - small) for early, late in zip(low, high, strict=True))
        print(
            f"each enclave beyond {small}: {cost * 1e3:.2f} ms, floor {floor_cost * 1e3:.2f} ms, "
            f"ratio {cost / floor_cost:.2f}; unproven {unproven / floor_cost:.2f}"
        )
    start, idle = median_of([*KEYMINT, "--help"]), median_of([sys.executable, "-c", "pass"])
    print(f"keymint --help: {start * 1e3:.0f} ms, an empty Python: {idle * 1e3:.0f} ms, ratio {start / idle:.1f}")


if __name__ == "__main__":
    main()
