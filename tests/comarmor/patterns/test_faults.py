# SPDX-License-Identifier: Apache-2.0
"""Mutations of documents: every one that changes the meaning is detected.

The definition decides whether a fault changes the meaning: every small pair of a partition and a topic is tried.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import pytest

from comarmor.patterns.counterexample_search import ProductSearch
from comarmor.patterns.decision_lists import Block, DecisionList, Equal, SearchBudget, Universe, Witness
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import Evaluator
from comarmor.patterns.glob import normalise, parse
from comarmor.patterns.proofs import difference
from comarmor.patterns.tokens import charset
from tests.effort import tries

PAIRS = Universe(charset([(65, 65), (97, 98), (47, 47)]), fields=2)
TOPICS = ["".join(word) for length in range(4) for word in product("abA/", repeat=length)]
PARTITIONS = ["", "a", "b"]
WORDS = sorted((f"{p}\0{t}" for p in PARTITIONS for t in TOPICS), key=len)
"""What is tried, shorter words first."""


@dataclass(frozen=True)
class Rule:
    """A rule of a document: its criteria, each a list of partitions and of topics."""

    allows: bool
    criteria: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]


Document = tuple[Rule, ...]


def lowered(document: Document) -> DecisionList:
    return tuple(
        Block(rule.allows, tuple(normalise((*parse(p), "\0", *parse(t))) for p in partitions for t in topics))
        for rule in document
        for partitions, topics in rule.criteria
    )


def some_pattern(r: random.Random) -> str:
    parts = ["a", "b", "/", "*", "?", "a", "b", "[!a]"]
    return "".join(r.choice(parts) for _ in range(r.randint(1, 3)))


def some_document(r: random.Random) -> Document:
    def criteria() -> tuple[tuple[str, ...], tuple[str, ...]]:
        partitions = r.choice([("",), ("",), ("",), ("a",), ("a", "b"), ("*",)])
        return partitions, tuple(some_pattern(r) for _ in range(r.randint(1, 3)))

    return tuple(
        Rule(r.random() < 0.6, tuple(criteria() for _ in range(r.randint(1, 2)))) for _ in range(r.randint(1, 4))
    )


def deny_dropped(r: random.Random, document: Document) -> Document:
    denials = [at for at, rule in enumerate(document) if not rule.allows]
    gone = r.choice(denials) if denials else r.randrange(len(document))
    return tuple(rule for at, rule in enumerate(document) if at != gone)


def reordered(r: random.Random, document: Document) -> Document:
    return tuple(r.sample(document, len(document)))


def effect_turned(r: random.Random, document: Document) -> Document:
    at = r.randrange(len(document))
    return tuple(replace(rule, allows=rule.allows ^ (i == at)) for i, rule in enumerate(document))


def _topic(change: Callable[[random.Random, str], str]) -> Callable[[random.Random, Document], Document]:
    def fault(r: random.Random, document: Document) -> Document:
        at = r.randrange(len(document))
        which = r.randrange(len(document[at].criteria))
        partitions, topics = document[at].criteria[which]
        number = r.randrange(len(topics))
        changed = (*topics[:number], change(r, topics[number]), *topics[number + 1 :])
        return _with(document, at, which, (partitions, changed))

    fault.__name__ = change.__name__
    return fault


def _with(document: Document, at: int, which: int, criteria: tuple[tuple[str, ...], tuple[str, ...]]) -> Document:
    rule = document[at]
    changed = replace(rule, criteria=(*rule.criteria[:which], criteria, *rule.criteria[which + 1 :]))
    return (*document[:at], changed, *document[at + 1 :])


def widened(r: random.Random, topic: str) -> str:
    at = r.randint(0, len(topic))
    return topic[:at] + r.choice("*?") + topic[at:]


def narrowed(r: random.Random, topic: str) -> str:
    wild = [at for at, char in enumerate(topic) if char in "*?"]
    if not wild:
        return topic
    at = r.choice(wild)
    return topic[:at] + r.choice(["", "a", "b"]) + topic[at + 1 :]


def prefix_wrong(r: random.Random, topic: str) -> str:
    return r.choice(["/", "a", "b"]) + topic if r.random() < 0.5 else topic[1:]


def suffix_wrong(r: random.Random, topic: str) -> str:
    return topic + r.choice(["/", "a", "b"]) if r.random() < 0.5 else topic[:-1]


def case_changed(_r: random.Random, topic: str) -> str:
    return topic.replace("a", "A", 1) if "[" not in topic else topic


def partition_missing(r: random.Random, document: Document) -> Document:
    at = r.randrange(len(document))
    which = r.randrange(len(document[at].criteria))
    partitions, topics = document[at].criteria[which]
    left = partitions[1:] or ("",)
    return _with(document, at, which, (left, topics))


def criteria_merged(r: random.Random, document: Document) -> Document:
    """Take partitions and topics of a rule, and of the next one, together: cross-talk."""
    at = r.randrange(len(document))
    pooled = [item for rule in document[at : at + 2] for item in rule.criteria]
    both = (tuple({p for ps, _ in pooled for p in ps}), tuple(t for _, ts in pooled for t in ts))
    return (*document[:at], Rule(document[at].allows, (both,)), *document[at + 2 :])


FAULTS = [
    deny_dropped, reordered, effect_turned, partition_missing, criteria_merged,
    *map(_topic, (widened, narrowed, prefix_wrong, suffix_wrong, case_changed)),
]  # fmt: skip
EACH = tries(70, 210)
"""Faults of each kind that change the meaning."""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_every_fault_that_changes_the_meaning_is_found(fault):
    r = random.Random(fault.__name__)
    faults = 0
    while faults < EACH:
        document = some_document(r)
        a, b = lowered(document), lowered(fault(r, document))
        permit, permit_broken = Evaluator(a).permits, Evaluator(b).permits
        first = next((word for word in WORDS if permit(word) is not permit_broken(word)), None)
        found = difference(a, b, universe=PAIRS)
        if first is not None:
            assert isinstance(found, Witness), (document, first)
            assert len(found.word) <= len(first)
            assert permit(found.word) is found.left is not permit_broken(found.word)
            faults += 1
        elif isinstance(found, Witness):  # beyond what was tried: a longer topic, or a partition of two letters
            assert found.word not in WORDS
        else:
            assert found == Equal()
            derivatives = Derivatives((p for decisions in (a, b) for block in decisions for p in block.patterns), PAIRS)
            assert ProductSearch((b,), a, PAIRS, derivatives, SearchBudget().state_counter()).shortest() is None


def test_there_are_enough_faults():
    assert EACH * len(FAULTS) >= tries(700, 2000)
