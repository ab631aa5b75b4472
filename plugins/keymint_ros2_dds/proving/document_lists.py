# SPDX-License-Identifier: Apache-2.0
"""Translate policies, grants and governance into decision lists, as each implementation reads them, and compare them.

If partitions are used, a word is ``partition NUL topic``, and a rule is the product of its partitions and topics; then
a combination that a rule permits by accident is a word, too. Otherwise a word is a topic in the default partition.

In a domain each topic is open (permissions are not checked), controlled (they are), or refused (no topic rule matches).
An endpoint is permitted if its topic is open, or controlled and permitted. Such a union is not a decision list, so the
comparison searches, case by case, for words that some lists permit and another one refuses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain

from comarmor.patterns import decision_lists, proofs
from comarmor.patterns.decision_lists import Block, DecisionList, Equal, ProofResult, SearchBudget, Unknown, Witness
from comarmor.patterns.glob import EVERYTHING, Glob, matches, parse
from comarmor.patterns.tokens import charset
from comarmor.rules import Effect
from comarmor.values import Data, replace
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.lowering.lowered_rules import Lowered, Partitions
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS, TopicAction
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.reading.signed_governance import DocumentDomainRule
from keymint_ros2_dds.reading.signed_permissions import DocumentCriteria, DocumentGrant, DocumentRule

_DEFAULT: Glob = ()


def has_partitions(lowered: Lowered, grants: Sequence[DocumentGrant]) -> bool:
    """Tell whether policy or document may allow anything outside of the default partition."""
    by_policy = any(listed not in {(), ("",)} for side in lowered.allow.values() for _, listed in side)
    return by_policy or have_partitions(grants)


def have_partitions(grants: Sequence[DocumentGrant]) -> bool:
    """Tell whether grants may allow anything outside of the default partition."""
    if any(grant.allows for grant in grants):
        return True  # by default, in every partition
    allowing = (rule for grant in grants for rule in grant.rules if rule.allows)
    return any(criteria.partitions not in {None, ("",)} for rule in allowing for criteria in rule.criteria)


def of_policy(lowered: Lowered, action: TopicAction, *, pairs: bool) -> DecisionList:
    """Return the decision list of a policy for an action: deny overrides allow."""
    blocks = []
    for effect, sides in ((Effect.DENY, lowered.deny), (Effect.ALLOW, lowered.allow)):
        every = (EVERYTHING,) if effect is Effect.DENY else (_DEFAULT,)
        topics: dict[Partitions, list[Glob]] = {}
        for topic, partitions in sides[action]:
            topics.setdefault(partitions, []).append(octets.of_glob(topic))
        words: dict[Glob, None] = {}
        for partitions, own in topics.items():
            listed = [octets.of_glob(parse(partition)) for partition in partitions]
            words |= dict.fromkeys(_words(listed or every, tuple(own), pairs=pairs))
        blocks.append(Block(effect is Effect.ALLOW, tuple(words)))
    return tuple(blocks)


def of_grant(
    grant: DocumentGrant, domain: int, action: str, semantics: Semantics, *, pairs: bool
) -> tuple[DecisionList, ...]:
    """Return the decision lists of a grant, all of which must permit: for endpoints, and for topics if checked.

    Where either direction may allow a topic, the list is that of the action: see :attr:`Semantics.bounds`.

    Args:
        grant: the grant.
        domain: DDS domain id.
        action: ``publish`` or ``subscribe``.
        semantics: how the grant is read.
        pairs: words have partitions.

    Raises:
        PatternError: implementations read an expression differently.
    """
    rules = [rule for rule in grant.rules if semantics.applies(rule, domain)]
    default = (Block(True, (EVERYTHING,)),) if semantics.default_counts and grant.allows else ()
    lists = [(*_endpoints(rules, action, semantics, pairs=pairs), *default)]
    if semantics.topic_check:
        # The first criteria that match the topic decide, of one direction or any.
        either = semantics.topic_check == "either"
        actions = {action} if either else {*TOPIC_ACTIONS} - {"relay"}
        naming = ((rule.allows, each.topics) for rule in rules for each in rule.criteria if each.action in actions)
        topics = ((allows, _read(expressions, semantics)) for allows, expressions in naming)
        blocks = (Block(allows, _words((EVERYTHING,), globs, pairs=pairs)) for allows, globs in topics)
        lists.append((*blocks, *default))
    return tuple(dict.fromkeys(lists))


def _endpoints(rules: Iterable[DocumentRule], action: str, semantics: Semantics, *, pairs: bool) -> Iterator[Block]:
    for rule in rules:
        own = [criteria for criteria in rule.criteria if criteria.action == action]
        for together in [own] if semantics.pools_criteria and own else [[criteria] for criteria in own]:
            if not rule.allows and semantics.tags_count and all(criteria.tags is not None for criteria in together):
                continue  # a denial of data tags does not apply to endpoints without them
            topics = _read(chain.from_iterable(criteria.topics for criteria in together), semantics)
            words = _words(_partitions(rule, together, semantics), topics, pairs=pairs)
            yield Block(rule.allows, words)
            if semantics.first_topic_decides and (named := _words((EVERYTHING,), topics, pairs=pairs)) != words:
                yield Block(False, named)


def _partitions(rule: DocumentRule, together: Sequence[DocumentCriteria], semantics: Semantics) -> tuple[Glob, ...]:
    unlisted = any(criteria.partitions is None for criteria in together)
    if not rule.allows and (semantics.deny_topic or (unlisted and not semantics.deny_default)):
        return (EVERYTHING,)
    listed = (p for criteria in together for p in (("",) if criteria.partitions is None else criteria.partitions))
    return _read(listed, semantics)


def _read(expressions: Iterable[str], semantics: Semantics) -> tuple[Glob, ...]:
    return octets.read(tuple(map(semantics.reads_text, expressions)), semantics.fnmatch)


def _words(partitions: Sequence[Glob], topics: tuple[Glob, ...], *, pairs: bool) -> tuple[Glob, ...]:
    if pairs:
        return tuple(octets.pair(partition, topic) for partition in partitions for topic in topics)
    return topics if _DEFAULT in partitions or any(matches(partition, "") for partition in partitions) else ()


WILDCARDS = "*?["
"""Fast DDS also matches the expressions of topic rules with the topic's name as a pattern. That makes no difference for
names without these characters."""
NOTHING: DecisionList = ()
"""Permits nothing."""


class Regions(Data):
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


class Permitted(Data):
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


def difference(
    policy: DecisionList, permitted: Permitted, universe: decision_lists.Universe, budget: SearchBudget
) -> ProofResult:
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
        wildcards = charset((ord(char), ord(char)) for char in WILDCARDS)
        universe = replace(universe, alphabet=universe.alphabet.intersection(wildcards.complement()))
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
    outside = (decision_lists.negate(permitted.exempt),) if permitted.exempt else ()
    yield (topics.opened, *outside), policy, False
    yield (endpoint, *topic, *outside), policy, False
    if topic:
        yield (endpoint, topics.either, *outside), policy, False
    for own, open_ in ((endpoint, topics.opened), *((checked, topics.either) for checked in topic)):
        yield (policy, decision_lists.negate(open_)), own, True
    yield (policy,), topics.covered, True
