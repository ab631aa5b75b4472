# SPDX-License-Identifier: Apache-2.0
"""Measure what a user waits for, as ratios to the least work possible: the table of ``docs/scale.md``.

usage: python benchmarks/fleet.py [--rows alike,own,...] [--large 10000] [--disk FOLDER] [--repeat 3]

A row compares whole processes with the *floor* of 1,000 enclaves (:mod:`floor`: a key, a certificate, one S/MIME
signature by the library and six files), measured before and after it. Everything is on tmpfs, except ``disk``. The best
repeat counts; folders are removed at the end only, since a file system is slow after a large removal. ext4 without a
journal looks past the inodes of what was removed in the last five minutes (``recently_deleted`` in ``fs/ext4/ialloc.c``
of Linux), so new files take up to ten times as long: measure ``disk`` once, where nothing was removed lately.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import floor

KEYMINT = (sys.executable, "-m", "keymint")
IMPORTS = (sys.executable, "-c", "import click, lxml.etree, cryptography.x509")
FLEET = 1000
PROFILE = """  <profile name="robot{robot}_{role}">
    <attachment>/robot{robot}/{role}</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/robot{robot}/chatter</attachment>
      <attachment>/fleet/map</attachment>
      <permissions><{permission}/></permissions>
    </ros_topic>
    <ros_service qualifier="ALLOW">
      <attachment>/fleet/report</attachment>
      <permissions><ros_call/></permissions>
    </ros_service>
{more}  </profile>
"""
OWN = """    <ros_topic qualifier="ALLOW">
      <attachment>/data/n{number}_*</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
    <ros_topic qualifier="DENY">
      <attachment>/data/n{number}_secret</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
"""

GROUP = """  <profile name="{role}s">
{attachments}    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/fleet/map</attachment>
      <permissions><{permission}/></permissions>
    </ros_topic>
  </profile>
"""
ROLES = (("talker", "ros_publish"), ("listener", "ros_subscribe"))


@dataclass(frozen=True)
class Spent:
    """What a process took: wall clock and processor time in seconds, memory of the largest one in MB; its output."""

    wall: float
    cpu: float
    memory: float
    out: bytes = b""


def policy(size: int, *, own: bool = False, extra: str = "") -> str:
    """Return a policy of talkers and listeners.

    Args:
        size: number of subjects.
        own: each subject has a wildcard and a denial of its own.
        extra: a rule for the first subject only.
    """
    return _document(
        PROFILE.format(
            robot=number // 2,
            role=ROLES[number % 2][0],
            permission=ROLES[number % 2][1],
            more=(OWN.format(number=number) if own else "") + (extra if number == 0 else ""),
        )
        for number in range(size)
    )


def groups(size: int) -> str:
    """Return a policy with one profile for all talkers and one for all listeners.

    For 100,000 subjects, profiles of their own are more than the limits of a policy allow.
    """
    return _document(
        GROUP.format(
            role=role,
            permission=permission,
            attachments="".join(f"    <attachment>/robot{robot}/{role}</attachment>\n" for robot in range(size // 2)),
        )
        for role, permission in ROLES
    )


def _document(profiles: Iterable[str]) -> str:
    return f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude">\n{"".join(profiles)}</profiles>\n'


def spent(*command: str, cwd: Path | None = None, codes: Sequence[int] = (0,)) -> Spent:
    """Run a command and return what it took; another exit code than those given ends the benchmark."""
    # An installed program has its modules compiled.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen(command, cwd=cwd, env=environment, stdout=out, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        if process.returncode not in codes:
            errors.seek(0)
            sys.exit(f"{' '.join(command)} ended with {process.returncode}: {errors.read().decode()[-2000:]}")
        return Spent(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, out.read())


def _timed(work: Callable[[], object]) -> Spent:
    """Do something in this process, and return what it took."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return Spent(time.perf_counter() - wall, time.process_time() - cpu, 0)


def best(repeat: int, *measures: Callable[[int], Spent]) -> tuple[Spent, ...]:
    """Return the shortest of several repeats of each measurement; they take turns, since machines are slow by turns."""
    rounds = [[measure(attempt) for measure in measures] for attempt in range(repeat)]
    return tuple(min(each, key=lambda spent: spent.wall) for each in zip(*rounds, strict=True))


class Benchmark:
    """Measures the rows of the table.

    Args:
        scratch: a folder on tmpfs.
        disk: a folder on a disk.
        repeat: repeats of each measurement.
        large: enclaves of the large fleet.
    """

    def __init__(self, scratch: Path, disk: Path, repeat: int, large: int) -> None:
        self._scratch = scratch
        self._disk = disk
        self._repeat = repeat
        self._large = large
        self._count = 0
        self._sample = self._permissions()

    def _permissions(self) -> bytes:
        folder = self._new(self._scratch)
        self._provision(folder, policy(1))
        return (folder / "ws/install/enclaves/robot0/talker/permissions.xml").read_bytes()

    def _new(self, parent: Path) -> Path:
        self._count += 1
        folder = parent / str(self._count)
        folder.mkdir()
        return folder

    def _provision(self, folder: Path, text: str | None = None, *options: str) -> Spent:
        if text is not None:
            (folder / "policy.xml").write_text(text)
        return spent(*KEYMINT, "provision", "policy.xml", "-w", "ws", "-q", *options, cwd=folder)

    def floor(self, size: int = FLEET) -> Spent:
        """Return what the floor of some enclaves takes."""
        folder, names = self._new(self._scratch), [f"robot{number}/talker" for number in range(size)]
        return _timed(lambda: floor.provision(folder, names, self._sample))

    def _cold(self, name: str, must: str, text: str) -> None:
        self._against_floor(name, must, lambda _: self._provision(self._new(self._scratch), text))

    def _against_floor(self, name: str, must: str, measure: Callable[[int], Spent]) -> None:
        before = self.floor()
        (took,) = best(self._repeat, measure)
        after = self.floor()
        wall, cpu = min(before.wall, after.wall), min(before.cpu, after.cpu)
        print(
            f"{name:42} {took.wall:8.2f} s  {took.wall / wall:6.2f} x wall  {took.cpu / cpu:6.2f} x CPU  "
            f"{took.memory:6.0f} MB   must: {must}",
            flush=True,
        )

    def alike(self) -> None:
        """1,000 alike subjects, from nothing to a proven keystore."""
        self._cold("1,000 alike, cold", "1.0 wall, 1.5 CPU", policy(FLEET))

    def own(self) -> None:
        """1,000 subjects, each with a wildcard and a denial of its own."""
        self._cold("1,000 with a wildcard of their own, cold", "2.2 CPU", policy(FLEET, own=True))

    def small(self) -> None:
        """Two enclaves against the imports that they need."""
        text = policy(2)
        provision = lambda _: self._provision(self._new(self._scratch), text)  # noqa: E731
        imports, took = best(5 * self._repeat, lambda _: spent(*IMPORTS), provision)
        ratio = took.wall / imports.wall
        print(f"{'2 enclaves, cold':42} {took.wall:8.2f} s  {ratio:6.2f} x imports            must: 1.9", flush=True)

    def disk(self) -> None:
        """300 enclaves on a disk against tmpfs, and how much more only their files take on the disk."""
        text = policy(300)
        whole = lambda folder: lambda _: self._provision(self._new(folder), text)  # noqa: E731
        sample = self._new(self._scratch)
        self._provision(sample, text)
        files = floor.content(sample / "ws")

        def alone(parent: Path) -> Callable[[int], Spent]:
            return lambda _: _timed(lambda: floor.write(self._new(parent), files))

        memory, took, memory_alone, took_alone = best(
            5 * self._repeat, whole(self._scratch), whole(self._disk), alone(self._scratch), alone(self._disk)
        )
        name, ratio = "300 enclaves on a disk", took.wall / memory.wall
        print(f"{name:42} {took.wall:8.2f} s  {ratio:6.2f} x tmpfs              must: 1.2", flush=True)
        more = took_alone.wall - memory_alone.wall
        name, ratio = "  their files alone, two processes", (memory.wall + more) / memory.wall
        print(f"{name:42} {more:8.2f} s  {ratio:6.2f} x tmpfs, if a run took no more than these", flush=True)

    def unchanged(self) -> None:
        """The same again."""
        for size, must in ((FLEET, "0.13"), (self._large, "0.9 for 10,000")):
            folder = self._new(self._scratch)
            self._provision(folder, policy(size))
            self._against_floor(f"{size:,}, nothing changed", must, lambda _, at=folder: self._provision(at))
            shutil.rmtree(folder)

    def one_rule(self) -> None:
        """One rule more for one subject of a large fleet."""
        folder = self._new(self._scratch)
        first = self._provision(folder, policy(self._large))
        print(f"{f'{self._large:,} alike, cold':42} {first.wall:8.2f} s  {first.memory:.0f} MB", flush=True)
        rule = OWN.format(number=7)
        change = lambda attempt: self._provision(folder, policy(self._large, extra=rule * (attempt % 2 + 1)))  # noqa: E731
        self._against_floor(f"one rule of {self._large:,}", "2.5", change)

    def verbs(self) -> None:
        """Questions about 1,000 enclaves."""
        folder = self._new(self._scratch)
        self._provision(folder, policy(FLEET))
        for verb, must, arguments, codes in (
            ("status", "0.25", ("-w", "ws"), (0,)),
            ("check", "1.2", ("-w", "ws"), (0,)),
            ("prove", "none", ("-w", "ws"), (0,)),
            ("lint", "0.7", ("policy.xml",), (0, 3)),
        ):
            command = (*KEYMINT, verb, *arguments)
            measure = lambda _, line=command, ok=codes: spent(*line, cwd=folder, codes=ok)  # noqa: E731
            self._against_floor(f"{verb}, 1,000", must, measure)

    def growth(self) -> None:
        """Processor time of an enclave by the number of enclaves, with wildcards of their own; it is linear."""
        for size in (10, 100, FLEET):
            text, folder = policy(size, own=True), self._new(self._scratch)
            bottom, first, again = self.floor(size), self._provision(folder, text), self._provision(folder)
            bare = self._provision(self._new(self._scratch), text, "--no-prove")
            print(
                f"{f'{size:,} wild, each':42} {first.cpu / size * 1e3:8.2f} ms {first.cpu / bottom.cpu:6.2f} x floor, "
                f"{bare.cpu / bottom.cpu:.2f} x unproven; again {again.cpu / first.cpu:.2f}",
                flush=True,
            )

    def memory(self) -> None:
        """Peak memory of the largest process for very many enclaves."""
        for size, of, must in ((10_000, policy, 200), (100_000, groups, 800)):
            took = self._provision(self._new(self._scratch), of(size))
            print(f"{f'{size:,} enclaves':42} {took.wall:8.2f} s  {took.memory:6.0f} MB   must: {must} MB", flush=True)
        (few,) = best(self._repeat, lambda _: self._provision(self._new(self._scratch), groups(FLEET)))
        ratio = took.cpu / size / (few.cpu / FLEET)
        print(f"{f'an enclave of {size:,}':42} {ratio:8.2f} x one of {FLEET:,} (CPU)   must: 1.2", flush=True)

    def diff(self) -> None:
        """One rule more in a policy of one subject with 5,000."""
        folder = self._new(self._scratch)
        for name, extra in (("old", ""), ("new", OWN.format(number=7))):
            rules = "".join(OWN.format(number=f"_{number}") for number in range(2_500))
            (folder / f"{name}.xml").write_text(
                _document([PROFILE.format(robot=0, role="talker", permission="ros_publish", more=rules + extra)])
            )
        command = (*KEYMINT, "diff", "old.xml", "new.xml")
        (took,) = best(self._repeat, lambda _: spent(*command, cwd=folder, codes=(0, 3)))
        print(f"{'diff, one rule of 5,000':42} {took.wall:8.2f} s   must: 3 s", flush=True)


ROWS = ("alike", "own", "small", "growth", "disk", "unchanged", "one_rule", "verbs", "diff", "memory")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default=",".join(ROWS[:-1]), help=f"of {', '.join(ROWS)}")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--large", type=int, default=10_000, help="enclaves of the large fleet")
    parser.add_argument("--disk", type=Path, default=Path.cwd(), help="a folder on a disk, e.g. ext4")
    options = parser.parse_args()
    tmpfs = Path("/dev/shm")
    with (
        tempfile.TemporaryDirectory(dir=tmpfs if tmpfs.is_dir() else None) as scratch,
        tempfile.TemporaryDirectory(dir=options.disk) as disk,
    ):
        benchmark = Benchmark(Path(scratch), Path(disk), options.repeat, options.large)
        for row in options.rows.split(","):
            getattr(benchmark, row)()
        shutil.rmtree(scratch, ignore_errors=True)


if __name__ == "__main__":
    main()
