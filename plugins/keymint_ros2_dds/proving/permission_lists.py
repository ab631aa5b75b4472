# SPDX-License-Identifier: Apache-2.0
"""Translate grants, as each implementation reads them, and policies into decision lists.

If partitions are used, a word is ``partition NUL topic``, and a rule is the product of its partitions and topics; then
a combination that a rule permits by accident is a word, too. Otherwise a word is a topic in the default partition.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

from comarmor.patterns.decision_lists import Block, DecisionList
from comarmor.patterns.glob import EVERYTHING, Glob, matches, parse
from comarmor.rules import Effect
from keymint_ros2_dds.decision.semantics import Semantics, TopicCheck
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import Partitions
from keymint_ros2_dds.lowering.lowered_rules import Lowered
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.reading.signed_permissions import DocumentCriteria, DocumentGrant, DocumentRule

_DEFAULT: Glob = ()


def has_partitions(lowered: Lowered, grants: Iterable[DocumentGrant]) -> bool:
    """Tell whether policy or document may allow anything outside of the default partition."""
    by_policy = any(listed not in {(), ("",)} for side in lowered.allow.values() for _, listed in side)
    return by_policy or have_partitions(grants)


def have_partitions(grants: Iterable[DocumentGrant]) -> bool:
    """Tell whether grants may allow anything outside of the default partition."""
    return any(
        grant.allows  # by default, in every partition
        or any(
            criteria.partitions not in {None, ("",)}
            for rule in grant.rules
            if rule.allows
            for criteria in rule.criteria
        )
        for grant in grants
    )


def of_policy(lowered: Lowered, action: str, *, pairs: bool) -> DecisionList:
    """Return the decision list of a policy for an action: deny overrides allow."""
    blocks = []
    for effect, sides in ((Effect.DENY, lowered.deny), (Effect.ALLOW, lowered.allow)):
        every = (EVERYTHING,) if effect is Effect.DENY else (_DEFAULT,)
        topics: dict[Partitions, list[Glob]] = {}
        for topic, partitions in sides[TopicAction(action)]:
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
        lists.append((*_topics(rules, action, semantics, pairs=pairs), *default))
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


def _topics(rules: Iterable[DocumentRule], action: str, semantics: Semantics, *, pairs: bool) -> Iterator[Block]:
    """Yield the blocks of the topic check: the first criteria that match the topic decide, of one direction or any."""
    actions = {action} if semantics.topic_check is TopicCheck.EITHER else {*TopicAction} - {TopicAction.RELAY}
    for rule in rules:
        for criteria in rule.criteria:
            if criteria.action in actions:
                topics = _read(criteria.topics, semantics)
                yield Block(rule.allows, _words((EVERYTHING,), topics, pairs=pairs))


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
