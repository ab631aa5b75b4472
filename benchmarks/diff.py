# SPDX-License-Identifier: Apache-2.0
"""Compare diff with brute force; print the counts and every pair of policies where diff is wrong.

usage: python benchmarks/diff.py [--pairs N] [--seed N]

Each pair of random policies is one edit apart (tests/keymint/analysis/edits.py). The reference evaluator decides every
request of some hundred subjects and objects. Exits with 1 if diff missed a change or reported a false one.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.keymint.analysis.differential import compared, pair


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    for seed in range(options.seed, options.seed + options.pairs):
        name, old, new = pair(seed)
        verdict = compared(old, new)
        counts["pairs"] += 1
        counts["with a difference" if verdict.differs else "without"] += 1
        if verdict.undecided:
            counts["undecided"] += 1
            print(f"seed {seed} ({name}): undecided, {'with a' if verdict.differs else 'no known'} difference")
        if verdict.wrong:
            counts["wrong"] += 1
            print(f"seed {seed} ({name}): {verdict.wrong}")
    print(", ".join(f"{number:,} {what}" for what, number in counts.items()))
    return 1 if counts["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
