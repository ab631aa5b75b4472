# SPDX-License-Identifier: Apache-2.0
"""Small words and lists, and the first difference by definition: the engine is compared with it."""

from __future__ import annotations

from itertools import product

from hypothesis import strategies as st

from comarmor.patterns.decision_lists import Block, DecisionList, Universe
from comarmor.patterns.evaluate import permits
from comarmor.patterns.glob import Glob, parse
from comarmor.patterns.tokens import charset

LETTERS = "ab"
UNIVERSE = Universe(charset([(97, 98)]))
PRINTABLE = Universe(charset([(0x20, 0x7E)]))
WORDS = ["".join(word) for length in range(7) for word in product(LETTERS, repeat=length)]
"""All words of the universe up to six letters, shorter ones first."""

texts = st.lists(st.sampled_from(["a", "b", "a", "b", "*", "?", "[!a]", "[ab]"]), max_size=5).map("".join)
globs = texts.map(parse)
blocks = st.builds(Block, st.booleans(), st.lists(globs, min_size=1, max_size=3).map(tuple))
lists = st.lists(blocks, max_size=4).map(tuple)


def allow(*patterns: str) -> Block:
    return Block(True, tuple(map(parse, patterns)))


def deny(*patterns: str) -> Block:
    return Block(False, tuple(map(parse, patterns)))


def first_difference(a: DecisionList, *b: DecisionList) -> str | None:
    """Return the first small word on which the lists differ, by definition."""
    return next((word for word in WORDS if permits(a, word) is not all(permits(each, word) for each in b)), None)


def patterns_of(*lists_: DecisionList) -> list[Glob]:
    return [pattern for decisions in lists_ for block in decisions for pattern in block.patterns]
