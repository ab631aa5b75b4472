"""What a governance document makes of topics, as decision lists beside those of the permissions.

In a domain each topic is open (its permissions are not asked), controlled (they are), or refused (no topic rule is
about it). So an endpoint is permitted if its topic is open, or controlled and permitted. Such a union of lists is no
decision list; the comparison asks instead for words that some lists permit and another one refuses, case by case.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

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
from comarmor.patterns.glob import EVERYTHING, Glob, normalise
from comarmor.patterns.proofs import escapes
from comarmor.patterns.tokens import Charset
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.proving.dialects import read
from keymint_ros2_dds.proving.permission_lists import SEPARATOR
from keymint_ros2_dds.reading.signed_governance import DocumentDomainRule

WILDCARDS = "*?["
"""Fast DDS takes the name of a topic for an expression about the expressions of topic rules, too. It makes no
difference for names without these characters."""
NOTHING: DecisionList = ()
"""Permits nothing."""


@dataclass(frozen=True, slots=True)
class Regions:
    """The topics of a domain, for an action.

    Attributes:
        opened: permits the topics whose permissions are not asked about the action.
        either: permits those whose permissions are not asked about the action or the other one.
        covered: permits the topics that a rule is about.
        closed: every topic is controlled.
    """

    opened: DecisionList
    either: DecisionList
    covered: DecisionList
    closed: bool


REFUSED = Regions(NOTHING, NOTHING, NOTHING, closed=False)
"""The topics of a domain that no rule matches."""


@lru_cache(maxsize=256)
def regions(rule: DocumentDomainRule, action: str, semantics: Semantics, *, pairs: bool) -> Regions:
    """Return what a domain rule makes of topics.

    Args:
        rule: the rule.
        action: ``publish`` or ``subscribe``.
        semantics: how the document is read.
        pairs: words have partitions; the governance knows none, so a topic is open in all of them.

    Raises:
        PatternError: implementations read an expression differently.
    """
    opened, either, covered = [], [], []
    for each in rule.topic_rules:
        found = patterns(each.expression, semantics, pairs=pairs)
        opened.append(Block(not each.controls(action), found))
        either.append(Block(not (each.read_controlled and each.write_controlled), found))
        covered.append(Block(True, found))
    closed = not any(block.allows for block in either) and any(
        _every(pairs=pairs) in block.patterns for block in covered
    )
    return Regions(tuple(opened), tuple(either), tuple(covered), closed)


def patterns(expression: str, semantics: Semantics, *, pairs: bool) -> tuple[Glob, ...]:
    """Return the words that a topic expression of the governance is about.

    Raises:
        PatternError: implementations read it differently.
    """
    found = read((semantics.reads_text(expression),), semantics.fnmatch)
    return tuple(normalise((*EVERYTHING, SEPARATOR, *topic)) for topic in found) if pairs else found


def _every(*, pairs: bool) -> Glob:
    return normalise((*EVERYTHING, SEPARATOR, *EVERYTHING)) if pairs else EVERYTHING


def refused(decisions: DecisionList) -> DecisionList:
    """Return the list that permits what a list refuses."""
    return (*(Block(not block.allows, block.patterns) for block in decisions), Block(True, (EVERYTHING,)))


def without_wildcards(universe: Universe) -> Universe:
    """Return the words of a universe that have no :data:`WILDCARDS`."""
    kept: list[tuple[int, int]] = []
    for low, high in universe.alphabet.ranges:
        at = low
        for char in sorted(map(ord, WILDCARDS)):
            if at <= char <= high:
                kept += [(at, char - 1)] if at < char else []
                at = char + 1
        kept += [(at, high)] if at <= high else []
    return Universe(Charset(tuple(kept)), universe.fields, universe.separator, universe.last_nonempty)


def difference(
    said: DecisionList,
    permitted: Sequence[DecisionList],
    found: Regions,
    exempt: DecisionList,
    universe: Universe,
    budget: SearchBudget,
) -> ProofResult:
    """Tell whether a policy says exactly what the documents permit.

    Args:
        said: what the policy says.
        permitted: the endpoint's list of the permissions, and the topic's where that is checked; all must permit.
        found: what the governance makes of topics.
        exempt: permits the topics that may be open.
        universe: the words in question.
        budget: what each of the questions may cost.

    Returns:
        :class:`Equal`, a shortest :class:`Witness` that an open topic or the permissions make the difference, or
        :class:`Unknown`.
    """
    best: Witness | None = None
    unknown: Unknown | None = None
    for together, refusing, left in _questions(said, permitted, found, exempt):
        outcome = escapes(together, refusing, universe, budget)
        if isinstance(outcome, Unknown):
            unknown = outcome
        elif isinstance(outcome, Witness) and (best is None or len(outcome.word) < len(best.word)):
            best = Witness(outcome.word, left)
    return best or unknown or Equal()


def _questions(
    said: DecisionList, permitted: Sequence[DecisionList], found: Regions, exempt: DecisionList
) -> Iterator[tuple[tuple[DecisionList, ...], DecisionList, bool]]:
    """Yield lists that permit together what another one refuses, and whether the policy is among the first.

    What is open for the action is open for either one, and what is open is covered. With the endpoint's list ``e`` and
    the topic's ``t``, the documents permit ``opened`` + ``e`` * ``either`` + ``e`` * ``t`` * ``covered``. The
    permissions alone must not permit more either, covered or not: peers hold them against a governance of their own.
    """
    endpoint, *topic = permitted
    outside = (refused(exempt),) if exempt else ()
    yield (found.opened, *outside), said, False
    yield (endpoint, *topic, *outside), said, False
    if topic:
        yield (endpoint, found.either, *outside), said, False
    for own, open_ in ((endpoint, found.opened), *((each, found.either) for each in topic)):
        yield (said, refused(open_)), own, True
    yield (said,), found.covered, True
