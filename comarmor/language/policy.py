# SPDX-License-Identifier: Apache-2.0
"""A loaded policy: the profiles and rules that apply to a subject, and decisions on requests.

DENY overrides ALLOW, and a request that no rule allows is denied. The rules that concern a permission are a row: names
without wildcards in a dictionary, the other expressions by the texts that they begin with. What a set of matching rules
decides is computed once.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

from comarmor.errors import ComArmorError, Reason
from comarmor.language.attachments import Tunable, parts
from comarmor.language.syntax import Decision, Inclusion, Profile, ProfileRule, files
from comarmor.patterns.expression import literal, literal_prefix, matches, rule_matches_partition
from comarmor.patterns.glob import parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.rules import PARTS, PERMISSIONS, Effect, Rule, suffixes
from comarmor.text import did_you_mean, quote
from comarmor.values import Data, field
from comarmor.xml.package_folders import ShippedFile


class Ruling(Data, eq=False):
    """What a policy decides, without the request.

    Attributes:
        effect: allow or deny.
        rules: the deciding rules, as in :class:`comarmor.language.syntax.Decision`.
        reason: one line for a person.
    """

    effect: Effect
    rules: tuple[Rule, ...]
    reason: Reason


class Row(ABC):
    """The rules of a subject that concern one permission.

    Attributes:
        kind: kind of the objects.
        permission: the permission.
        parts: the rows of the parts of a composite permission, each with what follows the object's name.
    """

    def __init__(self, kind: str, permission: str, parts: Sequence[tuple[Row, str]] = ()) -> None:
        self.kind = kind
        self.permission = permission
        self.parts = parts

    @abstractmethod
    def ruling(self, name: str, partitions: Sequence[str] = ()) -> Ruling:
        """Decide about an object.

        Args:
            name: name of the object, any text.
            partitions: partitions of the endpoint; none means the default partition, whose name is empty. The
                request is allowed if it is allowed in each of them.
        """

    @abstractmethod
    def allowed(self, names: Iterable[str]) -> bytes:
        """Decide about many objects in the default partition, one byte each: 1 allowed, 0 denied."""

    def decision(self, name: str, partitions: Sequence[str] = ()) -> Decision:
        """Decide about an object, and return the request with the decision; arguments as of :meth:`ruling`."""
        ruling = self.ruling(name, partitions)
        effect, rules, reason = ruling.effect, ruling.rules, ruling.reason
        parts = tuple(row.decision(name + suffix, partitions) for row, suffix in self.parts)
        return Decision(self.kind, self.permission, name, tuple(partitions), effect, rules, reason, parts)


class _ElementaryRow(Row):
    """The rules that concern a permission without parts, also as a part of one of theirs."""

    def __init__(self, rules: Sequence[Rule], kind: str, permission: str) -> None:
        super().__init__(kind, permission)
        self._rules = rules
        exact: dict[str, set[int]] = {}
        self._wild: list[tuple[int, str, str]] = []
        for at, rule in enumerate(rules):
            for suffix in suffixes(rule, kind, permission):
                for expression in rule.expressions:
                    text = literal(expression)
                    if text is None:
                        self._wild.append((at, expression, suffix))
                    else:
                        exact.setdefault(text + suffix, set()).add(at)
        self._exact = {name: tuple(sorted(positions)) for name, positions in exact.items()}
        self._beginnings = tuple({literal_prefix(expression) for _, expression, _ in self._wild})
        self._rulings: dict[tuple[int, ...], Ruling] = {}

    def _matching(self, name: str) -> tuple[int, ...]:
        """Return the positions of the rules that match a name."""
        found = self._exact.get(name, ())
        if not name.startswith(self._beginnings):
            return found
        wild = {
            at
            for at, expression, suffix in self._wild
            if name.endswith(suffix) and matches(expression, name.removesuffix(suffix))
        }
        return tuple(sorted(wild.union(found))) if wild else found

    def ruling(self, name: str, partitions: Sequence[str] = ()) -> Ruling:
        found = self._matching(name)
        if partitions:
            return self._ruled([self._rules[at] for at in found], partitions)
        ruling = self._rulings.get(found)
        if ruling is None:
            ruling = self._rulings[found] = self._ruled([self._rules[at] for at in found], ("",))
        return ruling

    def allowed(self, names: Iterable[str]) -> bytes:
        rulings, matching, allow = self._rulings, self._matching, Effect.ALLOW
        return bytes([(rulings.get(matching(name)) or self.ruling(name)).effect is allow for name in names])

    @staticmethod
    def _ruled(matching: Sequence[Rule], partitions: Iterable[str]) -> Ruling:
        """Return what the rules that match a name decide; that of the first partition that is denied."""
        allowing: dict[Rule, None] = {}
        for partition in partitions:
            shown = f" in partition {quote(partition)}" if partition else ""
            here = [rule for rule in matching if rule_matches_partition(rule, partition)]
            if denying := tuple(rule for rule in here if rule.effect is Effect.DENY):
                return Ruling(Effect.DENY, denying, Reason(("the DENY rule", denying[0].origin, f" matches{shown}")))
            if not here:
                return Ruling(Effect.DENY, (), Reason((f"no ALLOW rule matches{shown}",)))
            allowing |= dict.fromkeys(here)
        deciding = tuple(allowing)
        reason = Reason(("the ALLOW rule", deciding[0].origin, " matches, and no DENY rule does"))
        return Ruling(Effect.ALLOW, deciding, reason)


class _CompositeRow(Row):
    """The rules that concern the parts of a composite permission; all parts must be allowed."""

    def ruling(self, name: str, partitions: Sequence[str] = ()) -> Ruling:
        rules: dict[Rule, None] = {}
        for row, suffix in self.parts:
            ruling = row.ruling(name + suffix, partitions)
            if ruling.effect is Effect.DENY:
                part = f"a part of it, {row.permission} {quote(name + suffix)}, is denied: "
                return Ruling(Effect.DENY, ruling.rules, Reason((part, *ruling.reason.parts)))
            rules |= dict.fromkeys(ruling.rules)
        return Ruling(Effect.ALLOW, tuple(rules), Reason(("all parts of it are allowed",)))

    def allowed(self, names: Iterable[str]) -> bytes:
        listed = list(names)
        parts = [row.allowed(name + suffix for name in listed) for row, suffix in self.parts]
        return bytes(map(all, zip(*parts, strict=True)))


_MOST_CACHED = 1024
"""Subjects whose rules are cached."""
_MOST_INDEXED = 256
"""Subjects whose rules are indexed: questions come grouped by subject."""


class _ProfileLookup:
    """Sibling profiles, indexed by their attachments, so that a subject is not compared with each of them.

    Attributes:
        profiles: the profiles.
        attachments: their attachments, with the positions of the profiles.
        inner: the nested level of each profile, or None for a profile without nested ones.
    """

    def __init__(self, profiles: tuple[Profile, ...]) -> None:
        self.profiles = profiles
        self.attachments = PatternIndex(
            (parse(attachment.text), at) for at, profile in enumerate(profiles) for attachment in profile.attachments
        )
        self.inner = [_ProfileLookup(profile.profiles) if profile.profiles else None for profile in profiles]

    def applicable(self, subject: str) -> Iterator[Profile]:
        """Yield the profiles of this level and below that apply to a subject, outer ones first."""
        for position in sorted({position for _, position in self.attachments.matching(subject)}):
            yield self.profiles[position]
            inner = self.inner[position]
            if inner is not None:
                yield from inner.applicable(subject)


class Policy(Data, eq=False):
    """A policy.

    Attributes:
        profiles: the outermost profiles, in the order of the files.
        seen: every path that loading looked at, whether it exists or not, with its fingerprint
            (:func:`comarmor.language.source.fingerprint`). While the fingerprints are the same, so is the policy.
        unused_tunables: tunables that neither an attachment nor another tunable uses.
        shipped: those of its files that packages ship, each once.
    """

    profiles: tuple[Profile, ...]
    seen: Mapping[Path, bytes] = field(default_factory=dict)
    unused_tunables: tuple[Tunable, ...] = ()
    shipped: tuple[ShippedFile, ...] = ()
    _level: _ProfileLookup = field(init=False, repr=False)
    _last: dict[str, tuple[Profile, ...]] = field(init=False, repr=False, default_factory=dict)
    """The profiles that apply to the last subject: several questions about one follow each other."""
    _cached_rules: dict[str, tuple[Rule, ...]] = field(init=False, repr=False, default_factory=dict)
    _rows: dict[str, dict[tuple[str, str], Row]] = field(init=False, repr=False, default_factory=dict)
    _shared_rules: dict[int, Rule] = field(init=False, repr=False, default_factory=dict)
    """By identity of the profile's rule: the rules that are the same for all subjects."""

    _named: list[str] = field(init=False, repr=False, default_factory=list)
    _digests: dict[int, str] = field(init=False, repr=False, default_factory=dict)
    """By identity of a profile, or of the rules of an included file."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_level", _ProfileLookup(self.profiles))

    def applicable(self, subject: str) -> tuple[Profile, ...]:
        """Return the profiles that apply to a subject: an attachment of each, and of every enclosing one, matches it.

        Args:
            subject: any text; ROS 2 enclaves and nodes are named like ``/robot1/talker``.
        """
        found = self._last.get(subject)
        if found is None:
            found = tuple(self._level.applicable(subject))
            self._last.clear()
            self._last[subject] = found
        return found

    def rules(self, subject: str) -> tuple[Rule, ...]:
        """Return the rules of all profiles that apply to a subject, expanded for it."""
        cached = self._cached_rules.get(subject)
        if cached is not None:
            return cached
        namespace, name = parts(subject)
        rules: list[Rule] = []
        for part in chain.from_iterable(profile.parts for profile in self.applicable(subject)):
            if isinstance(part, Inclusion):
                rules += part.expanded(namespace, name)
            elif any(attachment.value for attachment in part.attachments):  # it names the subject
                rules.append(part.for_parts(namespace, name))
            else:
                if id(part) not in self._shared_rules:
                    self._shared_rules[id(part)] = part.for_parts(namespace, name)
                rules.append(self._shared_rules[id(part)])
        if len(self._cached_rules) >= _MOST_CACHED:
            self._cached_rules.clear()
        self._cached_rules[subject] = tuple(rules)
        return self._cached_rules[subject]

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

    def row(self, subject: str, kind: str, permission: str) -> Row:
        """Return what the rules of a subject say about a permission, for many requests; see :meth:`decide`."""
        if len(self._rows) >= _MOST_INDEXED and subject not in self._rows:
            self._rows.clear()
        rows = self._rows.setdefault(subject, {})
        row = rows.get((kind, permission))
        if row is None:
            _require("kind", kind, PERMISSIONS)
            _require("permission", permission, PERMISSIONS[kind], f" of {kind}")
            if composite := PARTS.get((kind, permission)):
                own = [(self.row(subject, part_kind, part), suffix) for part_kind, part, suffix in composite]
                row = _CompositeRow(kind, permission, own)
            else:
                row = _ElementaryRow(self.rules(subject), kind, permission)
            rows[kind, permission] = row
        return row

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
        if not self._named:
            self._named.extend(sorted(set(_subjects(self.profiles, ()))))
        return tuple(self._named)


def _require(what: str, name: str, known: Collection[str], owner: str = "") -> None:
    if name not in known:
        message = f"unknown {what} {quote(name)}{owner}, expected one of {', '.join(known)}"
        raise ComArmorError(message, help=did_you_mean(name, known), code=f"unknown-{what}")


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
