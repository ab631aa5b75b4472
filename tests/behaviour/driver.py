# SPDX-License-Identifier: Apache-2.0
"""The behaviour of a checkout, seen from its command line, and how that of another one differs.

    python tests/behaviour/driver.py record CHECKOUT RESULTS [--cases GLOB] [--policies 500] [-j 2]
    python tests/behaviour/driver.py compare RESULTS_A RESULTS_B

``record`` runs all cases and writes one JSON file for each: of every command the arguments, exit code, output, JSON
document, codes of findings, and the files that it changed, with modes and contents. ``compare`` prints what differs,
and ends with 1 if anything does. Record both checkouts with the same driver: it brings the examples and policies.
The clock is fixed, so dates are compared. What is random is called by the file that it comes from (see ``shown.py``);
the contents of ``.keymint/`` and of the register are not compared.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import multiprocessing
import shutil
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

if __package__ in {None, ""}:
    sys.path[0] = str(Path(__file__).resolve().parents[2])

from tests.behaviour import cases, compare
from tests.behaviour.checkout import Checkout
from tests.behaviour.record import Steps


class _Worker:
    """What a process of the driver keeps: its checkout, and its folder."""

    checkout: Checkout
    scratch: Path
    results: Path
    policies: int


def _start(checkout: Path, scratch: Path, results: Path, policies: int) -> None:
    # Names of this length only: some messages are shortened, and some are sorted by path.
    _Worker.scratch = Path(tempfile.mkdtemp(prefix="w", dir=scratch))
    _Worker.checkout = Checkout(checkout, _Worker.scratch)
    _Worker.results, _Worker.policies = results, policies


def _record(name: str) -> str:
    case = cases.all_cases(_Worker.policies)[name]
    folder = Path(tempfile.mkdtemp(prefix="c", dir=_Worker.scratch))
    try:
        steps = Steps(_Worker.checkout, folder)
        case(steps)
        text = json.dumps(steps.steps, indent=1)
        (_Worker.results / f"{name}.json").write_text(text)
    except Exception as error:  # noqa: BLE001 - the other cases go on
        return f"{name} failed: {type(error).__name__}: {error}"
    finally:
        shutil.rmtree(folder, onerror=_writable)
    return ""


def _writable(function: object, path: str, _error: object) -> None:
    for each in (Path(path).parent, Path(path)):
        each.chmod(0o700)
    function(path)  # type: ignore[operator]


def record(
    checkout: Path, results: Path, pattern: str = "*", policies: int = 500, jobs: int = 2
) -> tuple[int, list[str]]:
    """Record all cases whose name a pattern matches; return how many there are, and what failed in the driver.

    Args:
        checkout: the checkout whose command line is run.
        results: folder of the results, which is made; records of other cases stay.
        pattern: shell pattern of names of cases.
        policies: how many random policies.
        jobs: how many processes.
    """
    names = [name for name in cases.all_cases(policies) if fnmatch.fnmatchcase(name, pattern)]
    results.mkdir(parents=True, exist_ok=True)
    # A short path in a folder that no test or shell knows: relative paths to it never lead through a checkout.
    with tempfile.TemporaryDirectory(prefix="keymint-behaviour-") as scratch:
        given = (checkout.resolve(), Path(scratch), results.resolve(), policies)
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(jobs, len(names) or 1), context, _start, given) as pool:
            failed = []
            for number, error in enumerate(pool.map(_record, names), 1):
                failed += [error] if error else []
                if error or number % 50 == 0:
                    sys.stderr.write(f"{number}/{len(names)} {error}\n")
    return len(names), failed


def main(arguments: list[str] | None = None) -> int:
    """Run the driver and return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    recording = verbs.add_parser("record")
    recording.add_argument("checkout", type=Path)
    recording.add_argument("results", type=Path)
    recording.add_argument("--cases", default="*")
    recording.add_argument("--policies", type=int, default=500)
    recording.add_argument("-j", "--jobs", type=int, default=2)
    comparing = verbs.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--most", type=int, default=20, help="differences of a kind to print")
    given = parser.parse_args(arguments)
    if given.verb == "record":
        begin = time.monotonic()
        count, failed = record(given.checkout, given.results, given.cases, given.policies, given.jobs)
        sys.stdout.write(f"{count} cases in {time.monotonic() - begin:.0f} s\n")
        return 1 if failed else 0
    found = compare.differences(given.old, given.new)
    sys.stdout.writelines(f"{line}\n" for line in compare.report(found, given.most))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
