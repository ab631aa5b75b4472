# SPDX-License-Identifier: Apache-2.0
"""Check that random policies stay within the limits; print the most steps of each stage, and exit with 1 if not.

usage: python benchmarks/bounds.py [--policies N] [--seed N] [--families]

Steps are counted by comarmor.patterns.steps. No clock is read, so the figures are the same on every machine. A policy
is refused if the compiler gives up on one of its subjects; at most 2 in 100 may be. Subjects whose rules cannot be
expressed portably across vendors are counted separately. With --families, it also measures growing policies in two
sizes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from keymint.analysis import redundant_rules
from tests.bounds import COMPILE, Sweep, changed
from tests.families import FAMILIES
from tests.generated import minified, tokens


def main() -> int:
    """Run the sweep."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--policies", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--families", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sweep = Sweep(Path(folder))
        for seed in range(options.seed, options.seed + options.policies):
            text = minified(tokens(seed))
            sweep.run(str(seed), text, changed(text))
        if options.families:
            for name, family in FAMILIES.items():
                for size in (100, 200):
                    before = dict(sweep.tally.most)
                    sweep.tally.most.clear()
                    sweep.run(f"{name}({size})", family(size))
                    print(f"{name}({size}):", ", ".join(f"{k} {v[0]:,}" for k, v in sweep.tally.most.items()))
                    sweep.tally.most = before
    tally = sweep.tally
    print(f"{tally.policies} policies, {tally.subjects} subjects")
    for stage, (steps, name) in tally.most.items():
        print(f"{stage}: at most {steps:,} steps (policy {name})")
    print(f"refused: {len(tally.refused)} policies {tally.refused}")
    print(f"not portable across vendors: {tally.unportable} subjects")
    print(f"not proven: {len(tally.unproven)} subjects {tally.unproven}; lint unknown: {len(tally.unknown)} policies")
    within = tally.most["compile"][0] <= COMPILE and tally.most["lint"][0] <= 2 * redundant_rules.TOGETHER
    return 0 if within and len(tally.refused) * 50 <= options.policies else 1


if __name__ == "__main__":
    sys.exit(main())
