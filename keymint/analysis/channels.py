"""Find channels by which data can flow from one subject to another: topics, and requests and replies of services.

A channel is a name that one subject may write to and another one may read from. Actions and parameters consist of
topics and services. A channel is infrastructure if rules for every node allow it to both ends, e.g.
``ros_discovery_info``: every pair of nodes has it, so it is listed separately.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Block, DecisionList, Equal, Witness
from comarmor.patterns.glob import EVERYTHING, Glob, literal, parse
from comarmor.patterns.relations import TooComplexError, covers, intersection
from comarmor.rules import Effect
from keymint.analysis.rule_lists import (
    RAW,
    PermissionKey,
    allow_only,
    decision_list,
    find_permitted,
    in_partition,
    pattern_text,
    permission_keys,
    query_pattern,
    rule_patterns,
)
from keymint.analysis.subject_patterns import (
    EVERY,
    at_most,
    can_exist,
    profile_subjects,
    representatives,
    restrict_allowed,
    rules_of,
    structure,
)
from keymint.analysis.subject_templates import placeholders, symbolic_patterns
from keymint.api import LoadedPolicy, PolicyStructure

FLOWS: tuple[tuple[PermissionKey, PermissionKey], ...] = (
    ((RAW, "publish"), (RAW, "subscribe")),
    (("ros_topic", "ros_publish"), ("ros_topic", "ros_subscribe")),
    (("ros_service", "ros_call"), ("ros_service", "ros_execute")),
    (("ros_service", "ros_execute"), ("ros_service", "ros_call")),
)
"""Pairs of permissions of writer and reader: a client sends requests, a server sends replies."""


@dataclass(frozen=True, slots=True)
class Channel:
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


@dataclass(slots=True)
class ChannelSearch:
    """Finds channels.

    Attributes:
        policy: the policy.
        but: expressions of objects to ignore.
        common: returns True for a rule for every node; a channel that such rules allow to both ends is ignored, see
            :meth:`infrastructure`.
    """

    policy: LoadedPolicy
    but: Sequence[str]
    common: Callable[[Origin], bool] = field(default=lambda _: False)
    _known: dict[tuple[str, PermissionKey], DecisionList] = field(default_factory=dict)
    _known_common: dict[tuple[str, PermissionKey], tuple[Glob, ...]] = field(default_factory=dict)

    def path(self, sources: Sequence[str], targets: Sequence[str]) -> list[Channel] | None:
        """Return a shortest path of channels from one of the sources to one of the targets, or None.

        Subjects in between are those that the policy names.
        """
        goals = set(targets)
        seen = set(sources)
        queue: deque[tuple[str, list[Channel]]] = deque((source, []) for source in sources)
        everybody = [*dict.fromkeys((*targets, *self.policy.subjects()))]
        while queue:
            subject, path = queue.popleft()
            for other in everybody:
                if other in seen:
                    continue
                channel = next(self.between(subject, other), None)
                if channel is None:
                    continue
                if other in goals:
                    return [*path, channel]
                seen.add(other)
                queue.append((other, [*path, channel]))
        return None

    def between(self, writer: str, reader: str) -> Iterator[Channel]:
        """Yield channels from one subject to another, at most one for each expression of the writer's rules."""
        for send, receive in FLOWS:
            received = self._listed(reader, receive)
            if not _allows(received):
                continue
            sent = self._listed(writer, send)
            shared = _shared(self._common(writer, send), self._common(reader, receive))
            reported: set[str] = set()
            for pattern in (pattern for block in sent if block.allows for pattern in block.patterns):
                counts = self._counts(send[0], shared)
                outcome = find_permitted(send[0], restrict_allowed(pattern, sent), received, counts)
                if isinstance(outcome, Equal):
                    continue
                word = outcome.word if isinstance(outcome, Witness) else ""
                if word not in reported:
                    reported.add(word)
                    yield Channel(writer, reader, send[0], (send[1], receive[1]), word)

    def infrastructure(self, writer: str, reader: str) -> Iterator[Channel]:
        """Yield the channels from one subject to another that rules for every node allow to both ends."""
        for send, receive in FLOWS:
            for pattern in _shared(self._common(writer, send), self._common(reader, receive)):
                sent, received = self._listed(writer, send), self._listed(reader, receive)
                outcome = find_permitted(send[0], allow_only(pattern), sent, received, self._counts(send[0]))
                if not isinstance(outcome, Equal):
                    word = outcome.word if isinstance(outcome, Witness) else ""
                    yield Channel(writer, reader, send[0], (send[1], receive[1]), word)

    def possible(self, writers: Glob, readers: Glob) -> Iterator[Channel]:
        """Yield possible channels between subjects that the policy does not name.

        No result proves that there is none. Writer and reader are patterns of subjects.
        """
        written = structure(self.policy)
        if written is None:
            return
        for send, receive in FLOWS:
            try:
                sent = [one for piece in intersection(writers, EVERY) for one in at_most(written, piece, send)]
                received = [one for piece in intersection(readers, EVERY) for one in at_most(written, piece, receive)]
            except TooComplexError:
                yield Channel(pattern_text(writers), pattern_text(readers), send[0], (send[1], receive[1]), "")
                continue
            for subject, decided in sent:
                for other, decided2 in received:
                    if (literal(subject) is not None and literal(other) is not None) or not _allows(decided2):
                        continue  # subjects that the policy names are checked by between()
                    shared = _shared(self._surely(written, subject, send), self._surely(written, other, receive))
                    outcome = find_permitted(send[0], decided, decided2, self._counts(send[0], shared))
                    if not isinstance(outcome, Equal) and can_exist(subject) and can_exist(other):
                        word = outcome.word if isinstance(outcome, Witness) else ""
                        yield Channel(pattern_text(subject), pattern_text(other), send[0], (send[1], receive[1]), word)

    def named(self, expression: str) -> tuple[str, ...]:
        """Return the subjects of an expression; see :func:`~keymint.analysis.subject_patterns.representatives`."""
        return representatives(self.policy, parse(expression))

    def _listed(self, subject: str, key: PermissionKey) -> DecisionList:
        if (subject, key) not in self._known:
            self._known[subject, key] = decision_list(rules_of(self.policy, subject), key)
        return self._known[subject, key]

    def _common(self, subject: str, key: PermissionKey) -> tuple[Glob, ...]:
        """Return the patterns that rules for every node allow to a subject."""
        if (subject, key) not in self._known_common:
            rules = rules_of(self.policy, subject)
            self._known_common[subject, key] = tuple(
                dict.fromkeys(
                    pattern
                    for rule in rules
                    if rule.effect is Effect.ALLOW and key in permission_keys(rule) and self.common(rule.origin)
                    for expression in rule.expressions
                    for pattern in rule_patterns(rule, expression, key)
                )
            )
        return self._known_common[subject, key]

    def _surely(self, written: PolicyStructure, subjects: Glob, key: PermissionKey) -> tuple[Glob, ...]:
        """Return the patterns that rules for every node allow to every subject of a pattern."""
        return tuple(
            pattern
            for clause in written.clauses
            if clause.rule.effect is Effect.ALLOW
            and key in permission_keys(clause.rule)
            and self.common(clause.rule.origin)
            if any(covers(each, subjects) for each in profile_subjects(clause.profiles))
            for pattern in symbolic_patterns(clause, key)
            if not placeholders(pattern)
        )

    def _counts(self, kind: str, shared: Sequence[Glob] = ()) -> DecisionList:
        """Return the decision list of the names that are not ignored."""
        denied = (in_partition("*", parse(each)) if kind == RAW else query_pattern(kind, each) for each in self.but)
        return (Block(False, (*denied, *shared)), Block(True, (EVERYTHING,)))


def _shared(one: Sequence[Glob], other: Sequence[Glob]) -> tuple[Glob, ...]:
    """Return the intersections of patterns of both sides, without those that are too complex."""
    shared: dict[Glob, None] = {}
    for pattern in one:
        for pattern2 in other:
            try:
                shared |= dict.fromkeys(intersection(pattern, pattern2))
            except TooComplexError:
                continue
    return tuple(shared)


def _allows(decided: DecisionList) -> bool:
    return any(block.allows and block.patterns for block in decided)
