# SPDX-License-Identifier: Apache-2.0
"""The abstract syntax of a policy (profiles and rules), and decisions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.errors import Origin, Reason
from comarmor.language.attachments import Placeholder, Value, for_parts
from comarmor.patterns.expression import literal
from comarmor.rules import Effect, Rule, is_subject
from comarmor.values import Data

_LONGEST_NAME = 1024
_LONGEST_SEGMENT = 255


class Attachment(Data):
    """An attachment with its tunables expanded, in canonical notation.

    Attributes:
        text: ``fnmatch`` expression that may contain ``{name}`` and ``{namespace}``.
        where: where it is written.
        value: its pieces if it depends on the subject, else empty.
    """

    text: str
    where: Origin
    value: Value = ()

    @classmethod
    def of(cls, value: Value, where: Origin) -> Attachment:
        """Return the expression of these pieces."""
        return cls("".join(value), where, value if Placeholder in map(type, value) else ())

    def for_parts(self, namespace: str, name: str) -> str:
        """Return the expression for expressions of a namespace, which ends with ``/``, and of a name."""
        return for_parts(self.value, namespace, name) if self.value else self.text

    def included(self, chain: tuple[Origin, ...]) -> Attachment:
        """Return the attachment of a file that other places include, innermost first."""
        return Attachment(self.text, self.where.included(chain), self.value)


class ProfileRule(Data):
    """A rule as a profile writes it: tunables are expanded, ``{name}`` and ``{namespace}`` are not.

    Attributes:
        effect: allow or deny.
        kind: a key of :data:`comarmor.rules.PERMISSIONS`.
        permissions: permissions of that kind, in the order of that table.
        attachments: the rule applies to an object when any of them matches its name.
        partitions: as in :class:`comarmor.rules.Rule`.
        audit: matching requests are to be logged, by the rule's modifier or that of an enclosing profile.
        where: where it is written.
    """

    effect: Effect
    kind: str
    permissions: tuple[str, ...]
    attachments: tuple[Attachment, ...]
    partitions: tuple[str, ...]
    audit: bool
    where: Origin

    def for_parts(self, namespace: str, name: str, where: Origin | None = None) -> Rule:
        """Return the rule for a subject, whose parts are given as :meth:`Attachment.for_parts` needs them."""
        texts = [for_parts(each.value, namespace, name) if each.value else each.text for each in self.attachments]
        once = (texts[0],) if len(texts) == 1 else tuple(dict.fromkeys(texts))
        return Rule(self.effect, self.kind, self.permissions, once, self.partitions, self.audit, where or self.where)

    def written(self) -> str:
        """Return the rule and its files as text that differs for every other rule; lines do not count."""
        texts = (self.effect, self.kind, *self.permissions, *[each.text for each in self.attachments])
        partitions = (str(len(self.partitions)), *self.partitions, str(self.audit))
        return "\x1f".join((*texts, *partitions, files((self.where, *self.where.chain))))  # XML has no such character

    def with_expressions(self, expressions: Iterable[str]) -> Rule:
        """Return the rule with expressions in place of its attachments."""
        unique = tuple(dict.fromkeys(expressions))
        return Rule(self.effect, self.kind, self.permissions, unique, self.partitions, self.audit, self.where)


class Inclusion(Data):
    """The rules of an included file that uses no tunables: they are the same wherever it is included.

    Attributes:
        rules: the rules, whose places have the includes within that file only.
        chain: the places that include it, innermost first.
    """

    rules: tuple[ProfileRule, ...]
    chain: tuple[Origin, ...]

    def expanded(self, namespace: str, name: str) -> list[Rule]:
        """Return the rules for a subject, as :meth:`ProfileRule.for_parts`; rules of one file share their chain."""
        rules: list[Rule] = []
        inner, chain = None, self.chain
        for rule in self.rules:
            at = rule.where
            if at.chain is not inner:
                inner, chain = at.chain, (*at.chain, *self.chain)
            rules.append(rule.for_parts(namespace, name, at.with_chain(chain)))
        return rules

    def placed(self) -> Iterator[ProfileRule]:
        """Yield the rules with all places that include them."""
        for rule in self.rules:
            attachments = tuple(attachment.included(self.chain) for attachment in rule.attachments)
            place, given = rule.where.included(self.chain), rule.permissions
            yield ProfileRule(rule.effect, rule.kind, given, attachments, rule.partitions, rule.audit, place)


def unique(expressions: list[Attachment]) -> tuple[Attachment, ...]:
    """Return attachments without duplicate texts."""
    first: dict[str, Attachment] = {}
    for expression in expressions:
        first.setdefault(expression.text, expression)
    return tuple(first.values())


def expected_of_subject(expression: str) -> str:
    """Return what a subject's exact name violates of the form of enclaves' names, which become paths; empty if legal.

    Args:
        expression: the expression of a profile; one with wildcards is always legal.
    """
    name = literal(expression)
    if name is not None and (len(name) > _LONGEST_NAME or max(map(len, name.split("/"))) > _LONGEST_SEGMENT):
        return f"at most {_LONGEST_NAME} characters, and {_LONGEST_SEGMENT} between two '/'"
    if name is None or is_subject(name):
        return ""
    return "expected '/' and segments of letters, digits and '_' that do not begin with a digit, e.g. /robot1/talker"


def files(origins: Iterable[Origin]) -> str:
    """Return the files of some places as text."""
    return "".join([repr(origin.file) for origin in origins])


class Profile(Data):
    """A profile.

    Attributes:
        name: a label; need not be unique.
        audit: requests that match its rules are to be logged, by its modifier or that of an enclosing profile.
        attachments: the subjects it applies to, if all enclosing profiles apply to them as well.
        profiles: the nested profiles.
        parts: its rules in order; those of an included file in one piece.
        where: where it is written.
    """

    name: str
    audit: bool
    attachments: tuple[Attachment, ...]
    profiles: tuple[Profile, ...]
    parts: tuple[ProfileRule | Inclusion, ...]
    where: Origin

    @property
    def rules(self) -> tuple[ProfileRule, ...]:
        """The rules, each with all places that include it."""
        return tuple(
            rule for part in self.parts for rule in (part.placed() if isinstance(part, Inclusion) else (part,))
        )


class Decision(Data):
    """A policy's decision on one request, with the reason.

    Attributes:
        kind: kind of the object.
        permission: the requested permission.
        object: name of the object.
        partitions: partitions of the endpoint; empty: only the default partition.
        effect: allow or deny.
        rules: the deciding rules in the order of the policy; none if the request is denied because no rule allows it.
        reason: one line for a person.
        parts: for a composite permission, the decision on each part.
    """

    kind: str
    permission: str
    object: str
    partitions: tuple[str, ...]
    effect: Effect
    rules: tuple[Rule, ...]
    reason: Reason
    parts: tuple[Decision, ...] = ()

    @property
    def allowed(self) -> bool:
        """Whether the request is allowed."""
        return self.effect is Effect.ALLOW

    @property
    def rule(self) -> Rule | None:
        """The first deciding rule, or None if the request is denied because no rule allows it."""
        return self.rules[0] if self.rules else None

    @property
    def where(self) -> Origin | None:
        """Where the first deciding rule is written."""
        return self.rules[0].origin if self.rules else None

    @property
    def audit(self) -> bool:
        """Whether the request is to be logged."""
        return any(rule.audit for rule in self.rules)
