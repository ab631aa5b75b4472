# SPDX-License-Identifier: Apache-2.0
"""Find channels by which data can flow from one subject to another: topics, and requests and replies of services.

A channel is a name that one subject may write to and another one may read from. Actions and parameters consist of
topics and services. A channel is infrastructure if rules for every node allow it to both ends, e.g.
``ros_discovery_info``: every pair of nodes has it, so it is listed separately.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import product

from comarmor.patterns.decision_lists import DecisionList, Equal, Witness
from comarmor.patterns.glob import EVERYTHING, Glob, literal, parse
from comarmor.patterns.relations import TooComplexError, covers, intersection
from comarmor.rules import Effect
from comarmor.values import Data
from keymint.analysis.rule_lists import (
    RAW,
    PermissionKey,
    allow_only,
    decision_list,
    deny_over_allow,
    display_name,
    find_permitted,
    object_patterns,
    pattern_text,
    permission_keys,
    query_pattern,
    restrict_allowed,
    rule_patterns,
)
from keymint.analysis.subject_patterns import (
    EVERY,
    can_exist,
    expressions_for,
    fixed_expressions,
    namespace_name_splits,
    profile_subjects,
    rules_of,
)
from keymint.api import LoadedPolicy, PolicyStructure, WrittenRule
from keymint.errors import Origin

FLOWS: tuple[tuple[PermissionKey, PermissionKey], ...] = (
    ((RAW, "publish"), (RAW, "subscribe")),
    (("ros_topic", "ros_publish"), ("ros_topic", "ros_subscribe")),
    (("ros_service", "ros_call"), ("ros_service", "ros_execute")),
    (("ros_service", "ros_execute"), ("ros_service", "ros_call")),
)
"""Pairs of permissions of writer and reader: a client sends requests, a server sends replies."""


class Channel(Data):
    """A name by which data can flow from one subject to another.

    Attributes:
        writer: the sender.
        reader: the receiver.
        kind: kind of the object.
        permissions: permission of the writer and of the reader.
        word: a shortest such name; empty if it is unknown whether there is one.
    """

    writer: str
    reader: str
    kind: str
    permissions: tuple[str, str]
    word: str

    @property
    def object(self) -> str:
        """The name as display text; empty if it is unknown."""
        return display_name(self.kind, self.word)


class ChannelSearch:
    """Finds channels.

    Args:
        policy: the policy.
        but: expressions of objects to ignore.
        common: returns True for a rule for every node; a channel that such rules allow to both ends is ignored, see
            :meth:`infrastructure`.
    """

    def __init__(
        self, policy: LoadedPolicy, but: Sequence[str] = (), common: Callable[[Origin], bool] = lambda _: False
    ) -> None:
        self.but = but
        self._policy = policy
        self._is_common = common
        self._listed = cache(lambda subject, key: decision_list(rules_of(policy, subject), key))
        self._common = cache(self._common_patterns)
        self._lists = cache(self._lists_within)

    def path(self, sources: Sequence[str], targets: Sequence[str]) -> list[Channel] | None:
        """Return a shortest path of channels from one of the sources to one of the targets, or None.

        Subjects in between are those that the policy names. A subject has no path to itself, only from other sources.
        A source or target may be a pattern of subjects without a name: no path then proves that there is none.
        """
        goals = set(targets)
        # Two sources suffice: a target that is one of them is also reached from the other one.
        most = 2 if goals.intersection(sources) else 1
        reached: defaultdict[str, set[str]] = defaultdict(set, {source: {source} for source in sources})
        queue: deque[tuple[str, str, list[Channel]]] = deque((source, source, []) for source in sources)
        everybody = [*dict.fromkeys((*targets, *self._policy.subjects()))]
        while queue:
            source, subject, path = queue.popleft()
            for other in everybody:
                if other == subject or source in reached[other] or len(reached[other]) == most:
                    continue
                channel = next(self._channels(subject, other), None)
                if channel is None:
                    continue
                if other in goals:
                    return [*path, channel]
                reached[other].add(source)
                queue.append((source, other, [*path, channel]))
        return None

    def _channels(self, writer: str, reader: str) -> Iterator[Channel]:
        """Yield channels from one subject to another, or possible ones if one is a pattern."""
        one, other = parse(writer), parse(reader)
        exact = literal(one) is not None and literal(other) is not None
        return self.between(writer, reader) if exact else self.possible(one, other)

    def between(self, writer: str, reader: str) -> Iterator[Channel]:
        """Yield channels from one subject to another, at most one for each expression of the writer's rules."""
        reported: set[Channel] = set()
        for send, receive in FLOWS:
            received = self._listed(reader, receive)
            if not _allows(received):
                continue
            sent = self._listed(writer, send)
            counted = self._counted(send[0], _shared(self._common(writer, send), self._common(reader, receive)))
            for pattern in (pattern for block in sent if block.allows for pattern in block.patterns):
                lists = (restrict_allowed(pattern, sent), received, counted)
                channel = _channel(writer, reader, send, receive, *lists)
                if channel and channel not in reported:
                    reported.add(channel)
                    yield channel

    def infrastructure(self, pairs: Iterable[tuple[str, str]]) -> list[Channel]:
        """Return the channels that rules for every node allow to both ends, one for each name and direction.

        Args:
            pairs: writers and readers; a subject has no channel to itself.
        """
        found: dict[tuple[str, tuple[str, str], str], Channel] = {}
        for (writer, reader), (send, receive) in product(pairs, FLOWS):
            if writer == reader:
                continue
            for pattern in _shared(self._common(writer, send), self._common(reader, receive)):
                lists = (self._listed(writer, send), self._listed(reader, receive), self._counted(send[0]))
                channel = _channel(writer, reader, send, receive, allow_only(pattern), *lists)
                if channel:
                    found.setdefault((channel.kind, channel.permissions, channel.word), channel)
        return list(found.values())

    def possible(self, writers: Glob, readers: Glob) -> Iterator[Channel]:
        """Yield possible channels between subjects that the policy does not name.

        No result proves that there is none. Writer and reader are patterns of subjects.
        """
        written = self._policy.structure()
        if written is None or (literal(writers) is not None and literal(readers) is not None):
            return
        for send, receive in FLOWS:
            try:
                sent, received = self._lists(writers, send), self._lists(readers, receive)
            except TooComplexError:
                yield Channel(pattern_text(writers), pattern_text(readers), send[0], (send[1], receive[1]), "")
                continue
            for (subject, sent_list), (other, received_list) in product(sent, received):
                if (literal(subject) is not None and literal(other) is not None) or not _allows(received_list):
                    continue  # subjects that the policy names are checked by between()
                shared = _shared(
                    self._common_to_all(written, subject, send), self._common_to_all(written, other, receive)
                )
                lists = (sent_list, received_list, self._counted(send[0], shared))
                channel = _channel(pattern_text(subject), pattern_text(other), send, receive, *lists)
                if channel and can_exist(subject) and can_exist(other):
                    yield channel

    def _lists_within(self, within: Glob, key: PermissionKey) -> list[tuple[Glob, DecisionList]]:
        """Return patterns of the subjects that match a pattern, each with what any of them may do at most."""
        written, subject = self._policy.structure(), literal(within)
        if subject is not None or written is None:
            return [(within, self._listed(subject or "", key))]
        return [one for piece in intersection(within, EVERY) for one in _at_most(written, piece, key)]

    def _common_patterns(self, subject: str, key: PermissionKey) -> tuple[Glob, ...]:
        """Return the patterns that rules for every node allow to a subject."""
        return tuple(
            dict.fromkeys(
                pattern
                for rule in rules_of(self._policy, subject)
                if rule.effect is Effect.ALLOW and self._is_common(rule.origin)
                for pattern in object_patterns(rule, key)
            )
        )

    def _common_to_all(self, written: PolicyStructure, subjects: Glob, key: PermissionKey) -> tuple[Glob, ...]:
        """Return the patterns that rules for every node allow to every subject of a pattern."""
        return tuple(
            pattern
            for clause in _rules_for_all(written, Effect.ALLOW, subjects, key)
            if self._is_common(clause.rule.origin)
            for expression in fixed_expressions(clause)
            for pattern in rule_patterns(clause.rule, expression, key)
        )

    def _counted(self, kind: str, shared: Sequence[Glob] = ()) -> DecisionList:
        """Return the decision list of the names that are not ignored."""
        ignored = (query_pattern(kind, expression, "*") for expression in self.but)
        return deny_over_allow((*ignored, *shared), (EVERYTHING,))


def _channel(
    writer: str, reader: str, send: PermissionKey, receive: PermissionKey, *lists: DecisionList
) -> Channel | None:
    """Return the channel by a shortest name that all lists allow; None if there is provably none."""
    outcome = find_permitted(send[0], *lists)
    if isinstance(outcome, Equal):
        return None
    word = outcome.word if isinstance(outcome, Witness) else ""
    return Channel(writer, reader, send[0], (send[1], receive[1]), word)


def _at_most(written: PolicyStructure, within: Glob, key: PermissionKey) -> Iterator[tuple[Glob, DecisionList]]:
    """Yield patterns of subjects, each with a decision list that allows at least what any of them may do.

    Args:
        written: structure of a policy.
        within: pattern of the subjects.
        key: a kind, and a permission without parts.

    Raises:
        TooComplexError: the profiles overlap in too many ways.
    """
    for clause in written.clauses:
        if clause.rule.effect is not Effect.ALLOW or key not in permission_keys(clause.rule):
            continue
        for subjects in profile_subjects(clause.profiles, within):
            allowed = dict.fromkeys(
                pattern
                for namespace, name in namespace_name_splits(subjects)
                for expression in clause.expand(pattern_text(namespace), pattern_text(name))
                for pattern in rule_patterns(clause.rule, expression, key)
            )
            subject = literal(subjects)
            denied = (
                pattern
                for denial in _rules_for_all(written, Effect.DENY, subjects, key)
                for expression in (fixed_expressions(denial) if subject is None else expressions_for(denial, subject))
                for pattern in rule_patterns(denial.rule, expression, key)
            )
            yield subjects, deny_over_allow(denied, allowed)


def _rules_for_all(
    written: PolicyStructure, effect: Effect, subjects: Glob, key: PermissionKey
) -> Iterator[WrittenRule]:
    """Yield the rules of an effect that apply to every subject of a pattern."""
    for clause in written.clauses:
        applies = clause.rule.effect is effect and key in permission_keys(clause.rule)
        if applies and any(covers(each, subjects) for each in profile_subjects(clause.profiles)):
            yield clause


def _shared(one: Sequence[Glob], other: Sequence[Glob]) -> tuple[Glob, ...]:
    """Return the intersections of patterns of both sides, without those that are too complex."""
    shared: dict[Glob, None] = {}
    for patterns in product(one, other):
        with suppress(TooComplexError):
            shared |= dict.fromkeys(intersection(*patterns))
    return tuple(shared)


def _allows(decided: DecisionList) -> bool:
    return any(block.allows and block.patterns for block in decided)
