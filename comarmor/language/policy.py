"""A loaded policy: which profiles apply to a subject, what rules it has, and what it may do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from comarmor.language.decide import decide
from comarmor.language.syntax import Decision, Profile, Rule, Tunable
from comarmor.patterns.expression import beginning, literal, matches

_MOST_REMEMBERED = 4096
"""Subjects whose rules a policy remembers."""


@dataclass(frozen=True, slots=True)
class _Level:
    """Sibling profiles, indexed so that a subject is looked up and not compared with every exact name.

    Attributes:
        profiles: the profiles.
        exact: positions of the profiles that name a subject exactly.
        patterns: position and expression of the other attachments, by the text that they begin with.
        lengths: the lengths of these texts.
        inner: the level below each profile, or None for a profile without profiles.
    """

    profiles: tuple[Profile, ...]
    exact: Mapping[str, list[int]]
    patterns: Mapping[str, list[tuple[int, str]]]
    lengths: tuple[int, ...]
    inner: tuple[_Level | None, ...]

    @classmethod
    def of(cls, profiles: tuple[Profile, ...]) -> _Level:
        exact: dict[str, list[int]] = {}
        patterns: dict[str, list[tuple[int, str]]] = {}
        for position, profile in enumerate(profiles):
            for attachment in profile.attachments:
                name = literal(attachment.text)
                if name is None:
                    patterns.setdefault(beginning(attachment.text), []).append((position, attachment.text))
                else:
                    exact.setdefault(name, []).append(position)
        inner = tuple(cls.of(profile.profiles) if profile.profiles else None for profile in profiles)
        return cls(profiles, exact, patterns, tuple(sorted(set(map(len, patterns)))), inner)

    def applicable(self, subject: str) -> Iterator[Profile]:
        """Yield the profiles of this level and below that apply to a subject, outer ones first."""
        found = set(self.exact.get(subject, ()))
        for length in self.lengths:
            near = self.patterns.get(subject[:length], ()) if length <= len(subject) else ()
            found.update(position for position, text in near if position not in found and matches(text, subject))
        for position in sorted(found):
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
        seen: every path that was looked at, also those that were not there, with their fingerprints
            (:func:`comarmor.language.source.fingerprint`): as long as these are the same, so is the policy.
        unused_tunables: tunables that no attachment and no other tunable refers to.
    """

    profiles: tuple[Profile, ...]
    files: Mapping[Path, bytes] = field(default_factory=dict)
    seen: Mapping[Path, bytes] = field(default_factory=dict)
    unused_tunables: tuple[Tunable, ...] = ()
    _level: _Level = field(init=False, repr=False)
    _remembered: dict[str, tuple[Rule, ...]] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_level", _Level.of(self.profiles))

    def applicable(self, subject: str) -> tuple[Profile, ...]:
        """Return the profiles that apply to a subject: an attachment matches, and so for every profile around it.

        Args:
            subject: any text; ROS 2 enclaves and nodes are named like ``/robot1/talker``.
        """
        return tuple(self._level.applicable(subject))

    def rules(self, subject: str) -> tuple[Rule, ...]:
        """Return the rules of all profiles that apply to a subject, their expressions expanded for it."""
        known = self._remembered.get(subject)
        if known is not None:
            return known
        rules = tuple(_expanded(rule, subject) for profile in self.applicable(subject) for rule in profile.rules)
        if len(self._remembered) >= _MOST_REMEMBERED:
            self._remembered.clear()
        self._remembered[subject] = rules
        return rules

    def decide(
        self,
        subject: str,
        kind: str,
        permission: str,
        object: str,  # noqa: A002 - the field's name for what is accessed
        partitions: Sequence[str] = (),
    ) -> Decision:
        """Decide what the policy says about a request.

        Args:
            subject: who asks; any text.
            kind: kind of the object, e.g. ``ros_topic``.
            permission: a permission of that kind, e.g. ``ros_publish``.
            object: name of the object; any text.
            partitions: DDS partitions of the endpoint; none means the default partition.

        Raises:
            ComArmorError: the kind or the permission is not known.
        """
        return decide(self.rules(subject), kind, permission, object, partitions)

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly and that some profile so named applies to."""
        return tuple(sorted(set(_subjects(self.profiles, ()))))


def _subjects(profiles: tuple[Profile, ...], around: tuple[Profile, ...]) -> Iterator[str]:
    for profile in profiles:
        for attachment in profile.attachments:
            name = literal(attachment.text)
            if name is not None and all(_attaches(outer, name) for outer in around):
                yield name
        yield from _subjects(profile.profiles, (*around, profile))


def _attaches(profile: Profile, subject: str) -> bool:
    return any(matches(attachment.text, subject) for attachment in profile.attachments)


def _expanded(rule: Rule, subject: str) -> Rule:
    if not any(attachment.value for attachment in rule.attachments):
        return rule
    return replace(rule, attachments=tuple(attachment.expanded(subject) for attachment in rule.attachments))
