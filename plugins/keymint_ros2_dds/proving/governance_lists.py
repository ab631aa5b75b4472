# SPDX-License-Identifier: Apache-2.0
"""Translate a governance document into decision lists, and compare a policy with governance and permissions together.

In a domain each topic is open (permissions are not checked), controlled (they are), or refused (no topic rule matches).
An endpoint is permitted if its topic is open, or controlled and permitted. Such a union is not a decision list, so the
comparison searches, case by case, for words that some lists permit and another one refuses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

from comarmor.patterns import proofs
from comarmor.patterns.decision_lists import (
    Block,
    DecisionList,
    Equal,
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
    negate,
)
from comarmor.patterns.glob import EVERYTHING, Glob
from comarmor.patterns.tokens import charset
from comarmor.values import dataclass
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.reading.signed_governance import DocumentDomainRule

WILDCARDS = "*?["
"""Fast DDS also matches the expressions of topic rules with the topic's name as a pattern. That makes no difference for
names without these characters."""
NOTHING: DecisionList = ()
"""Permits nothing."""


@dataclass(frozen=True, slots=True)
class Regions:
    """The topics of a domain, by access control for an action.

    Attributes:
        opened: permits the topics that are open for the action.
        either: permits the topics that are open for this action or the other one.
        covered: permits the topics that a rule matches.
    """

    opened: DecisionList
    either: DecisionList
    covered: DecisionList


REFUSED = Regions(NOTHING, NOTHING, NOTHING)
"""The topics of a domain that no rule matches."""


@dataclass(frozen=True, slots=True)
class Permitted:
    """What the documents permit.

    Attributes:
        lists: decision lists of the permissions, of which all must permit.
        regions: topics by their governance; None if every topic is under access control.
        exempt: permits the topics that the sources leave open, as the profile accepts.
        both_ways: names with wildcards are excluded, because topic rules match them in both directions.
    """

    lists: tuple[DecisionList, ...]
    regions: Regions | None = None
    exempt: DecisionList = NOTHING
    both_ways: bool = False


NOTHING_PERMITTED = Permitted((NOTHING,))


@lru_cache(maxsize=256)
def regions(rule: DocumentDomainRule, action: str, semantics: Semantics, *, pairs: bool) -> Regions:
    """Return the topics of a domain rule, by access control.

    Args:
        rule: the rule.
        action: ``publish`` or ``subscribe``.
        semantics: how the document is read.
        pairs: words have partitions; a governance has none, so a topic is open in all of them.

    Raises:
        PatternError: implementations read an expression differently.
    """
    topics = [(each, patterns(each.expression, semantics, pairs=pairs)) for each in rule.topic_rules]
    return Regions(
        opened=tuple(Block(not each.controls(action), globs) for each, globs in topics),
        either=tuple(Block(not each.controlled, globs) for each, globs in topics),
        covered=tuple(Block(True, globs) for _, globs in topics),
    )


def is_closed(rule: DocumentDomainRule, semantics: Semantics) -> bool:
    """Tell whether a domain rule puts every topic under access control; errors as of :func:`regions`."""
    matched = (patterns(each.expression, semantics, pairs=False) for each in rule.topic_rules)
    return not rule.opens and any(EVERYTHING in globs for globs in matched)


def patterns(expression: str, semantics: Semantics, *, pairs: bool) -> tuple[Glob, ...]:
    """Return the words that a topic expression of the governance matches.

    Raises:
        PatternError: implementations read it differently.
    """
    globs = octets.read((semantics.reads_text(expression),), semantics.fnmatch)
    return tuple(octets.pair(EVERYTHING, topic) for topic in globs) if pairs else globs


def without_wildcards(universe: Universe) -> Universe:
    """Return the words of a universe without :data:`WILDCARDS`."""
    wildcards = charset((ord(char), ord(char)) for char in WILDCARDS)
    return replace(universe, alphabet=universe.alphabet.intersection(wildcards.complement()))


def difference(policy: DecisionList, permitted: Permitted, universe: Universe, budget: SearchBudget) -> ProofResult:
    """Compare what a policy allows with what the documents permit.

    Args:
        policy: what the policy allows.
        permitted: what the documents permit.
        universe: the words to compare.
        budget: limits of each search.

    Returns:
        :class:`Equal`, a shortest :class:`Witness`, or :class:`Unknown`.
    """
    if permitted.regions is None:
        return proofs.difference(policy, *permitted.lists, universe=universe, budget=budget)
    if permitted.both_ways:
        universe = without_wildcards(universe)
    best: Witness | None = None
    unknown: Unknown | None = None
    for together, refusing, left in _questions(policy, permitted, permitted.regions):
        outcome = proofs.escapes(together, refusing, universe, budget)
        if isinstance(outcome, Unknown):
            unknown = outcome
        elif isinstance(outcome, Witness) and (best is None or len(outcome.word) < len(best.word)):
            best = Witness(outcome.word, left)
    return best or unknown or Equal()


def _questions(
    policy: DecisionList, permitted: Permitted, topics: Regions
) -> Iterator[tuple[tuple[DecisionList, ...], DecisionList, bool]]:
    """Yield the searches: lists that all permit, one that refuses, and whether the policy is among the first.

    A topic that is open for the action is open for either one, and is covered. With the endpoint's list ``e`` and
    the topic's ``t``, the documents permit ``opened`` + ``e`` * ``either`` + ``e`` * ``t`` * ``covered``. The
    permissions alone must not permit more either, covered or not: peers evaluate them with their own governance.
    """
    endpoint, *topic = permitted.lists
    outside = (negate(permitted.exempt),) if permitted.exempt else ()
    yield (topics.opened, *outside), policy, False
    yield (endpoint, *topic, *outside), policy, False
    if topic:
        yield (endpoint, topics.either, *outside), policy, False
    for own, open_ in ((endpoint, topics.opened), *((checked, topics.either) for checked in topic)):
        yield (policy, negate(open_)), own, True
    yield (policy,), topics.covered, True
