# SPDX-License-Identifier: Apache-2.0
"""A loaded policy: the profiles and rules that apply to a subject, and decisions on requests."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path

from comarmor.language.attachments import Tunable, parts
from comarmor.language.decide import Row, RuleIndex
from comarmor.language.syntax import Decision, Inclusion, Profile, ProfileRule, files
from comarmor.patterns.expression import literal, matches
from comarmor.patterns.glob import parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.rules import Rule
from comarmor.values import dataclass
from comarmor.xml.package_folders import ShippedFile

_MOST_CACHED = 4096
"""Subjects whose rules are cached."""
_MOST_INDEXED = 256
"""Subjects whose rules are indexed: questions come grouped by subject."""


@dataclass(frozen=True, slots=True)
class _ProfileLookup:
    """Sibling profiles, indexed by their attachments, so that a subject is not compared with each of them.

    Attributes:
        profiles: the profiles.
        attachments: their attachments, with the positions of the profiles.
        inner: the nested level of each profile, or None for a profile without nested ones.
    """

    profiles: tuple[Profile, ...]
    attachments: PatternIndex[int]
    inner: tuple[_ProfileLookup | None, ...]

    @classmethod
    def of(cls, profiles: tuple[Profile, ...]) -> _ProfileLookup:
        attachments = PatternIndex(
            (parse(attachment.text), at) for at, profile in enumerate(profiles) for attachment in profile.attachments
        )
        inner = tuple(cls.of(profile.profiles) if profile.profiles else None for profile in profiles)
        return cls(profiles, attachments, inner)

    def applicable(self, subject: str) -> Iterator[Profile]:
        """Yield the profiles of this level and below that apply to a subject, outer ones first."""
        for position in sorted({position for _, position in self.attachments.matching(subject)}):
            yield self.profiles[position]
            inner = self.inner[position]
            if inner is not None:
                yield from inner.applicable(subject)


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """A policy.

    Attributes:
        profiles: the outermost profiles, in the order of the files.
        files: every file that was read, by its resolved path, with the SHA-256 of its bytes.
        seen: every path that loading looked at, whether it exists or not, with its fingerprint
            (:func:`comarmor.language.source.fingerprint`). While the fingerprints are the same, so is the policy.
        unused_tunables: tunables that neither an attachment nor another tunable uses.
        shipped: those of its files that packages ship, each once.
    """

    profiles: tuple[Profile, ...]
    files: Mapping[Path, bytes] = field(default_factory=dict)
    seen: Mapping[Path, bytes] = field(default_factory=dict)
    unused_tunables: tuple[Tunable, ...] = ()
    shipped: tuple[ShippedFile, ...] = ()
    _level: _ProfileLookup = field(init=False, repr=False)
    _cached_rules: dict[str, tuple[Rule, ...]] = field(init=False, repr=False, default_factory=dict)
    _indexes: dict[str, RuleIndex] = field(init=False, repr=False, default_factory=dict)
    _shared_rules: dict[int, Rule] = field(init=False, repr=False, default_factory=dict)
    """By identity of the profile's rule: the rules that are the same for all subjects."""

    _digests: dict[int, str] = field(init=False, repr=False, default_factory=dict)
    """By identity of a profile, or of the rules of an included file."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_level", _ProfileLookup.of(self.profiles))

    def applicable(self, subject: str) -> tuple[Profile, ...]:
        """Return the profiles that apply to a subject: an attachment of each, and of every enclosing one, matches it.

        Args:
            subject: any text; ROS 2 enclaves and nodes are named like ``/robot1/talker``.
        """
        return tuple(self._level.applicable(subject))

    def rules(self, subject: str) -> tuple[Rule, ...]:
        """Return the rules of all profiles that apply to a subject, expanded for it."""
        cached = self._cached_rules.get(subject)
        if cached is not None:
            return cached
        namespace, name = parts(subject)
        rules = tuple(
            rule
            for profile in self.applicable(subject)
            for part in profile.parts
            for rule in (
                part.expanded(namespace, name)
                if isinstance(part, Inclusion)
                else (self._expanded(part, namespace, name),)
            )
        )
        if len(self._cached_rules) >= _MOST_CACHED:
            self._cached_rules.clear()
        self._cached_rules[subject] = rules
        return rules

    def rules_digest(self, subject: str) -> str | None:
        """Return a digest that differs if the rules of a subject or their files do; None if no profile applies to it.

        Lines do not count, so that a rule more for one subject leaves all others as they are. It costs less than the
        rules, because profiles and included files have theirs once for all subjects.
        """
        profiles = self.applicable(subject)
        return _digest([subject, *[self._digest_of(each, each.parts) for each in profiles]]) if profiles else None

    def _digest_of(self, owner: object, rules: tuple[ProfileRule | Inclusion, ...]) -> str:
        """Return the digest of the rules of a profile or an included file, which live as long as the policy."""
        if id(owner) not in self._digests:
            self._digests[id(owner)] = _digest(
                f"{self._digest_of(each.rules, each.rules)}{files(each.chain)}"
                if isinstance(each, Inclusion)
                else each.written()
                for each in rules
            )
        return self._digests[id(owner)]

    def _expanded(self, rule: ProfileRule, namespace: str, name: str) -> Rule:
        if rule.depends_on_subject:
            return rule.for_parts(namespace, name)
        if id(rule) not in self._shared_rules:
            self._shared_rules[id(rule)] = rule.for_parts(namespace, name)
        return self._shared_rules[id(rule)]

    def row(self, subject: str, kind: str, permission: str) -> Row:
        """Return what the rules of a subject say about a permission, for many requests; see :meth:`decide`."""
        index = self._indexes.get(subject)
        if index is None:
            if len(self._indexes) >= _MOST_INDEXED:
                self._indexes.clear()
            index = self._indexes[subject] = RuleIndex(self.rules(subject))
        return index.row(kind, permission)

    def decide(
        self,
        subject: str,
        kind: str,
        permission: str,
        object: str,  # noqa: A002 - the field's name for what is accessed
        partitions: Sequence[str] = (),
    ) -> Decision:
        """Decide a request.

        Args:
            subject: name of the subject; any text.
            kind: kind of the object, e.g. ``ros_topic``.
            permission: a permission of that kind, e.g. ``ros_publish``.
            object: name of the object; any text.
            partitions: partitions of the endpoint; none means the default partition.

        Raises:
            ComArmorError: the kind or the permission is not known.
        """
        return self.row(subject, kind, permission).decision(object, partitions)

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that an attachment names exactly and that its profile applies to."""
        return tuple(sorted(set(_subjects(self.profiles, ()))))


def _digest(texts: Iterable[str]) -> str:
    return hashlib.sha256("\x1e".join(texts).encode(errors="surrogatepass")).hexdigest()


def _subjects(profiles: tuple[Profile, ...], around: tuple[Profile, ...]) -> Iterator[str]:
    for profile in profiles:
        for attachment in profile.attachments:
            name = literal(attachment.text)
            if name is not None and all(_attaches(outer, name) for outer in around):
                yield name
        yield from _subjects(profile.profiles, (*around, profile))


def _attaches(profile: Profile, subject: str) -> bool:
    return any(matches(attachment.text, subject) for attachment in profile.attachments)
