"""A policy as data: profiles, rules, and what was decided by them."""

from __future__ import annotations

from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.language.template import Placeholder, Value, for_subject
from comarmor.rules import Effect


@dataclass(frozen=True, slots=True)
class Expression:
    """An attachment, its tunables expanded, in canonical notation.

    Attributes:
        text: ``fnmatch`` expression, in which ``{name}`` and ``{namespace}`` may stand.
        where: where a person wrote it.
        value: its pieces when it depends on the subject; else empty.
    """

    text: str
    where: Origin
    value: Value = ()

    @classmethod
    def of(cls, value: Value, where: Origin) -> Expression:
        """Return the expression that consists of these pieces."""
        return cls("".join(value), where, value if any(isinstance(p, Placeholder) for p in value) else ())

    def expanded(self, subject: str) -> Expression:
        """Return the expression that this one is for a subject."""
        return Expression(for_subject(self.value, subject), self.where) if self.value else self


@dataclass(frozen=True, slots=True)
class Tunable:
    """A variable: its name, its values (expressions, expanded), and where it is declared."""

    name: str
    values: tuple[Value, ...]
    where: Origin


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule of a profile.

    Attributes:
        effect: allow or deny.
        kind: a key of :data:`PERMISSIONS`.
        permissions: permissions of that kind, in its order.
        attachments: what it is about; a name matches when any of them does.
        partitions: DDS partitions as ``fnmatch`` expressions (kind ``topic`` only); empty: not narrowed.
        audit: to be watched, by its own modifier or that of a profile around it.
        where: where a person wrote it.
    """

    effect: Effect
    kind: str
    permissions: tuple[str, ...]
    attachments: tuple[Expression, ...]
    partitions: tuple[str, ...]
    audit: bool
    where: Origin


@dataclass(frozen=True, slots=True)
class Profile:
    """A profile.

    Attributes:
        name: a label; need not be unique.
        audit: to be watched, by its own modifier or that of a profile around it.
        attachments: the subjects it applies to, as far as the profiles around it do.
        profiles: the profiles in it.
        rules: its rules.
        where: where a person wrote it.
    """

    name: str
    audit: bool
    attachments: tuple[Expression, ...]
    profiles: tuple[Profile, ...]
    rules: tuple[Rule, ...]
    where: Origin


@dataclass(frozen=True, slots=True)
class Decision:
    """What a policy says about one request, and why.

    Attributes:
        kind: kind of the object.
        permission: the permission asked for.
        object: name of the object.
        partitions: DDS partitions of the endpoint; empty: only the default partition.
        effect: allow or deny.
        rules: the rules that decided, in the order of the policy; none when nothing allows it.
        reason: one line for a person.
        parts: for a composite permission, the decision on each part.
    """

    kind: str
    permission: str
    object: str
    partitions: tuple[str, ...]
    effect: Effect
    rules: tuple[Rule, ...]
    reason: str
    parts: tuple[Decision, ...] = ()

    @property
    def allowed(self) -> bool:
        """Whether the request is allowed."""
        return self.effect is Effect.ALLOW

    @property
    def rule(self) -> Rule | None:
        """The first rule that decided, or None when it is denied because nothing allows it."""
        return self.rules[0] if self.rules else None

    @property
    def where(self) -> Origin | None:
        """Where the first rule that decided is written."""
        return self.rules[0].where if self.rules else None

    @property
    def audit(self) -> bool:
        """Whether a rule that decided is to be watched."""
        return any(rule.audit for rule in self.rules)
