# SPDX-License-Identifier: Apache-2.0
"""Check that all readers see the same content in every signed file that Keymint accepts; exit with 1 if not.

Mutated files are read by Keymint, by OpenSSL's functions as the vendors call them, by ``openssl smime -verify``, by
Cyclone DDS's access-control plugin, and by Python's ``email``.

usage: python benchmarks/signed_files.py [--count N] [--seed N] [--workers N]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.real.signed_readers import Bench, Counts

CHUNK = 1000
"""Number of files per seed; the documents are signed again for each seed."""


def compared(task: tuple[int, int]) -> Counts:
    count, seed = task
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(Path(scratch), cyclone=True)
        counts = bench.compare(count, seed)
        for name, signed, text in bench.genuine:
            counts.counts["files as tools sign them"] += 1
            readings = {reader: read(signed) for reader, read in bench.readers.items()}
            readings["Keymint"] = bench.by_keymint(signed)
            for reader, content in readings.items():
                if content is None or content.replace(b"\r\n", b"\n") != text:
                    counts.wrong.append(f"{name}, seed {seed}: {reader} reads other content than was signed")
        return counts


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000, help="mutated files; 20000 by default")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    starts = range(0, arguments.count, CHUNK)
    tasks = [(min(CHUNK, arguments.count - start), arguments.seed * 1_000_000 + start) for start in starts]
    total, wrong = Counter[str](), list[str]()
    with ProcessPoolExecutor(arguments.workers) as pool:
        for counts in pool.map(compared, tasks):
            total += counts.counts
            wrong += counts.wrong
            print(f"\r{total['files']} of {arguments.count} files", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    for name, number in sorted(total.items()):
        print(f"{number:8} {name}")
    print(f"{len(wrong):8} read differently by others")
    print(*wrong[:20], sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
