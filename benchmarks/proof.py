# SPDX-License-Identifier: Apache-2.0
"""Measure proofs: equality of lists of K patterns, and hard families; ``fleet.py`` measures those of enclaves.

usage: python benchmarks/proof.py [--sizes 10,100,1000,5000]

Of K patterns 80 % are names, the rest have a wildcard at the start, at the end, at both, or inside; one in five is
denied. The other list is equal but has no pattern with wildcards in common: ``u*v`` becomes ``uv`` and ``u?*v``. Memory
is the peak of the process so far.
"""

from __future__ import annotations

import argparse
import random
import resource
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product

from comarmor.patterns.decision_lists import (
    Block,
    DecisionList,
    Equal,
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
)
from comarmor.patterns.glob import parse
from comarmor.patterns.proofs import difference
from comarmor.patterns.tokens import Charset

WORDS = (  # noqa: SIM905 - a list of strings would be harder to read
    "arm base camera chatter cmd depth drive estop fleet gripper image imu joint lidar map motor nav odom plan pose "
    "scan state status task twist wheel"
).split()
PRINTABLE = Universe(Charset(((0x20, 0x7E),)))
LIMIT = 10.0
"""Seconds for a question."""
EXACT = 0.8
"""Share of the patterns that are names."""


def patterns(size: int) -> list[str]:
    """Return different expressions, the same on every run."""
    dice = random.Random(size)
    expressions: dict[str, None] = {}
    while len(expressions) < size:
        name = "/".join(f"{dice.choice(WORDS)}{dice.randrange(100)}" for _ in range(dice.randint(2, 4)))
        forms = [f"rt/{name}/*", f"rt/*/{name}", f"*{name}", f"*{name}*"]
        expressions[f"rt/{name}" if dice.random() < EXACT else dice.choice(forms)] = None
    return list(expressions)


def rewritten(expressions: Iterable[str]) -> Iterator[str]:
    """Yield expressions that match the same names and have no wildcard pattern in common with those given."""
    for expression in expressions:
        if expression.startswith("*") and expression.endswith("*"):
            yield from (expression[1:], f"?{expression}", f"{expression[1:-1]}?*")
        elif "*" in expression:
            head, _, tail = expression.partition("*")
            yield from (head + tail, f"{head}?*{tail}")
        else:
            yield expression


def decisions(denied: Iterable[str], allowed: Iterable[str]) -> DecisionList:
    """Return the list of a policy: denials first."""
    return Block(False, tuple(map(parse, denied))), Block(True, tuple(map(parse, allowed)))


def measured(a: DecisionList, b: DecisionList) -> tuple[ProofResult, float]:
    """Return the result of a comparison and its duration in seconds."""
    start = time.perf_counter()
    budget = SearchBudget(5_000_000, lambda: time.perf_counter() - start < LIMIT)
    result = difference(a, b, universe=PRINTABLE, budget=budget)
    return result, time.perf_counter() - start


def memory() -> str:
    """Return the peak memory of this process."""
    return f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024} MB"


def equality(sizes: Sequence[int]) -> None:
    print(f"{'K':>6}  {'equal':>9}  {'one changed':>11}  memory")
    for size in sizes:
        drawn = patterns(size)
        denied, allowed = drawn[::5], [each for at, each in enumerate(drawn) if at % 5]
        a, b = decisions(denied, allowed), decisions(rewritten(denied), rewritten(allowed))
        equal, seconds = measured(a, b)
        last = next(each for each in reversed(allowed) if "*" not in each)
        changed, seconds2 = measured(a, decisions(rewritten(denied), [*rewritten(e for e in allowed if e != last)]))
        assert isinstance(equal, Equal), equal
        assert not isinstance(changed, Unknown), changed
        print(f"{size:>6}  {seconds:>8.2f}s  {seconds2:>10.2f}s  {memory()}")


def _allow(*expressions: str) -> DecisionList:
    return (Block(True, tuple(map(parse, expressions))),)


TEXTS = ["".join(pair) for pair in product("abcdefghij", "klmnopqrst")]
BITS = ["".join(bits) for bits in product("ab", repeat=7)][:100]
HARD: dict[str, Callable[[], tuple[DecisionList, DecisionList]]] = {
    "100 overlapping infixes": lambda: (
        _allow(*(f"*{t}*" for t in BITS)),
        _allow(*(p for t in BITS for p in (f"*{t}", f"*{t}?*"))),
    ),
    "100 denied infixes": lambda: (
        decisions((f"*{t}*" for t in TEXTS), ["*"]),
        decisions((p for t in TEXTS for p in (f"*{t}", f"*{t}?*")), ["*"]),
    ),
    "100 pairs of infixes": lambda: (
        _allow(*(f"*{t}*{u}*" for t, u in zip(TEXTS, TEXTS[1:] + TEXTS[:1], strict=True))),
        _allow(*(p for t, u in zip(TEXTS, TEXTS[1:] + TEXTS[:1], strict=True) for p in (f"*{t}{u}*", f"*{t}?*{u}*"))),
    ),
    "100 steps in turn": lambda: (
        tuple(Block(at % 2 == 0, (parse(f"*{t}*"),)) for at, t in enumerate(TEXTS)),
        tuple(Block(at % 2 == 0, (parse(f"*{t}"), parse(f"*{t}?*"))) for at, t in enumerate(TEXTS)),
    ),
    "100 far from the end": lambda: (
        _allow(*(f"*{t}{'?' * 24}" for t in TEXTS)),
        _allow(*(f"*{t}{'?' * 23}{last}" for t in TEXTS for last in ("b", "[!b]"))),
    ),
    "100 words of one length": lambda: (
        _allow("?" * 100),
        _allow("a" * 100, *("?" * at + "[!a]" + "?" * (99 - at) for at in range(100))),
    ),
    "100 pigeonholes": lambda: (
        _allow("*"),
        _allow(*(f"*{'?' * at}a{'?' * at}a*" for at in range(100)), "*[!a]*", "", "a"),
    ),
    "100 lengths": lambda: (_allow("?" * 100 + "*"), _allow(*("?" * at for at in range(100, 200)), "?" * 200 + "*")),
    "100 mixed, far letters": lambda: (
        _allow(*(f"*a{'?' * at}b*" for at in range(100))),
        _allow(*(p for at in range(100) for p in (f"*a{'?' * at}b", f"*a{'?' * at}b?*"))),
    ),
}


def hard() -> None:
    for name, make in HARD.items():
        result, seconds = measured(*make())
        note = result.reason if isinstance(result, Unknown) else ""
        note = f"a difference: {result.word!r}" if isinstance(result, Witness) else note
        print(f"{name:>24}  {type(result).__name__.lower():>8}  {seconds:>6.2f}s  {note}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="10,100,1000,5000")
    chosen = parser.parse_args()
    equality([int(each) for each in chosen.sizes.split(",")])
    hard()


if __name__ == "__main__":
    main()
