"""Do random policies of all features stay within the limits? Prints the most steps of each stage; ends with 1 if not.

usage: python benchmarks/bounds.py [--policies N] [--seed N] [--families]

Steps are those of comarmor.patterns.steps: no clock is read, so that the figures are the same on every machine. A
policy is refused if the compiler gives one of its subjects up; at most 2 in 100 may be. What vendors do not read
alike is not counted as that. With --families policies that grow are tried as well, in two sizes.
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
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sweep = Sweep(Path(folder))
        for seed in range(asked.seed, asked.seed + asked.policies):
            text = minified(tokens(seed))
            sweep.run(str(seed), text, changed(text))
        if asked.families:
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
    print(f"not read alike by all vendors: {tally.unportable} subjects")
    print(f"not proven: {len(tally.unproven)} subjects {tally.unproven}; lint unknown: {len(tally.unknown)} policies")
    within = tally.most["compile"][0] <= COMPILE and tally.most["lint"][0] <= 2 * redundant_rules.TOGETHER
    return 0 if within and len(tally.refused) * 50 <= asked.policies else 1


if __name__ == "__main__":
    sys.exit(main())
