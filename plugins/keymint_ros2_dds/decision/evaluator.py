# SPDX-License-Identifier: Apache-2.0
"""Decide about an endpoint by the documents of its enclave, as the standard and each vendor do.

The governance determines whether the permissions are checked at all. DDS Security 1.1, 9.4.3: the participant must be
allowed to join; then the first topic rule that matches the topic determines whether permissions are checked. A topic
without a rule is refused.

Permissions are evaluated by Algorithm 1 of White et al. 2018 (DDS Security 1.1, 9.4.1.3), with vendor deviations.
Subject name and validity select a grant. The first criteria, in document order, that match domain, action, topic,
partitions and data tags decide, else the grant's default. If no grant matches, the result is an error, which denies.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import datetime
from functools import cached_property, lru_cache

from comarmor.patterns.expression import literal_prefix
from comarmor.patterns.tokens import Dialect
from comarmor.values import Data
from keymint.api import Verdict
from keymint.errors import Origin
from keymint_ros2_dds.decision.semantics import OMG, Semantics, Variation
from keymint_ros2_dds.reading import dialects, signed_permissions
from keymint_ros2_dds.reading.signed_governance import ACCESS, DocumentDomainRule, DocumentTopicRule, GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, DocumentRule, PermissionsDocument

DEFAULT_PARTITION = ("",)
_NO_GRANT = DocumentGrant("", "", "", (), allows=False, line=0)


class _Expressions(Data):
    """Expressions of one list, compiled, and the texts that names begin with which those with wildcards match."""

    plain: frozenset[str]
    wild: re.Pattern[str] | None
    beginnings: frozenset[str]

    def match(self, name: str) -> bool:
        return name in self.plain or (self.wild is not None and self.wild.fullmatch(name) is not None)


class TopicDecisions:
    """Which topics are allowed by the first step that matches each: names in a dictionary, and the other expressions.

    Args:
        steps: expressions with what they decide, in the order of the document.
        default: what no expression matches.
    """

    def __init__(self, steps: Iterable[tuple[_Expressions, bool]], default: bool) -> None:
        self._allows: list[bool] = []
        self._plain: dict[str, int] = {}
        self._wild: list[tuple[int, re.Pattern[str]]] = []
        beginnings: set[str] = set()
        for at, (expressions, allows) in enumerate(steps):
            self._allows.append(allows)
            for name in expressions.plain:
                self._plain.setdefault(name, at)
            if expressions.wild is not None:
                self._wild.append((at, expressions.wild))
                beginnings.update(expressions.beginnings)
        self._beginnings = tuple(beginnings)
        self._allows.append(default)

    def allows(self, name: str) -> bool:
        """Tell whether a topic is allowed; its name is in bytes."""
        at = self._plain.get(name, -1)
        if name.startswith(self._beginnings):
            for place, expressions in self._wild:
                if 0 <= at < place:
                    break
                if expressions.fullmatch(name) is not None:
                    at = place
                    break
        return self._allows[at]


class _CriteriaStep(Data):
    """Criteria of a rule; or all criteria of a rule, pooled.

    ``partitions`` is None where every partition matches.
    """

    allows: bool
    action: str
    topics: _Expressions
    partitions: _Expressions | None
    tags: frozenset[tuple[str, str]] | None
    line: int


class DocumentEvaluator:
    """Decides about the endpoints of one subject in a domain by one document.

    Args:
        document: the document.
        subject_name: the identity's, as text in the order of RFC 2253: ``CN=/talker,OU=h``.
        now: the clock, UTC.
        domain: DDS domain id.
        variation: the standard, or an implementation.

    Attributes:
        semantics: how the implementation reads documents.
        refusal: the decision about every endpoint, if there is no grant to evaluate; else None.
        joins: the participant may join: an allow_rule applies in the domain, or the default allows.
    """

    def __init__(
        self, document: PermissionsDocument, subject_name: str, now: datetime, domain: int, variation: Variation = OMG
    ) -> None:
        semantics = variation.semantics
        self.semantics = semantics
        self._place = document.place
        self._steps: dict[str, list[_CriteriaStep]] = {}
        self._named: list[_CriteriaStep] = []
        self._by_action: dict[str, TopicDecisions] = {}
        found = _grant(document, subject_name, now, semantics)
        self.refusal = found if isinstance(found, Verdict) else None
        grant = _NO_GRANT if isinstance(found, Verdict) else found
        self._default = semantics.default_counts and grant.allows
        self._default_line = grant.line
        in_domain = [rule for rule in grant.rules if semantics.applies(rule, domain)]
        self.joins = self._default or any(rule.allows for rule in in_domain)
        for step in _steps(in_domain, semantics):
            self._steps.setdefault(step.action, []).append(step)
            if step.action != "relay":
                self._named.append(step)

    def decide(
        self,
        action: str,
        topic: str,
        partitions: Sequence[str] = (),
        tags: Collection[tuple[str, str]] = (),
        *,
        topic_checked: bool = True,
    ) -> Verdict:
        """Decide about an endpoint.

        Args:
            action: ``publish``, ``subscribe`` or ``relay``.
            topic: DDS topic name.
            partitions: of the endpoint's publisher or subscriber; none is the default partition.
            tags: data tags of the endpoint.
            topic_checked: the governance controls both reading and writing the topic; implementations with a topic
                check then perform it.
        """
        if self.refusal is not None:
            return self.refusal
        name = dialects.in_bytes(topic)
        if topic_checked and self.semantics.topic_check:
            named = [next((step for step in each if step.topics.match(name)), None) for each in self._naming]
            if not any(self._default if step is None else step.allows for step in named):
                denying = next(filter(None, named), None)
                if denying is None:
                    return self._by_default(topic)
                return self._by(denying, f"denies the topic {topic!r}", allowed=False)
        names = [dialects.in_bytes(partition) for partition in partitions] or DEFAULT_PARTITION
        for step in self._steps.get(action, ()):
            if not step.topics.match(name):
                continue
            if self._matches(step, names, tags):
                verb = "allows" if step.allows else "denies"
                return self._by(step, f"{verb} {action} {topic!r}", allowed=step.allows)
            if self.semantics.first_topic_decides:
                return self._by(step, f"names {topic!r}, but not in these partitions", allowed=False)
        return self._by_default(topic)

    def allows(self, action: str, name: str, *, topic_checked: bool) -> bool:
        """Tell whether an endpoint in the default partition, without data tags, is allowed; see :meth:`decide`.

        Args:
            action: as of :meth:`decide`.
            name: DDS topic name in bytes.
            topic_checked: as of :meth:`decide`.
        """
        if self.refusal is not None:
            return False
        if topic_checked and self._topic_checks and not any(each.allows(name) for each in self._topic_checks):
            return False
        if action not in self._by_action:
            steps = [
                (step.topics, step.allows and matches)
                for step in self._steps.get(action, ())
                if (matches := self._matches(step, DEFAULT_PARTITION, ())) or self.semantics.first_topic_decides
            ]
            self._by_action[action] = TopicDecisions(steps, self._default)
        return self._by_action[action].allows(name)

    @property
    def _naming(self) -> Sequence[Sequence[_CriteriaStep]]:
        """The criteria of which the first ones that match a topic decide whether it may exist; any may allow it."""
        if self.semantics.topic_check == "either":
            return [self._steps.get(action, []) for action in ("publish", "subscribe")]
        return [self._named] if self.semantics.topic_check else []

    @cached_property
    def _topic_checks(self) -> Sequence[TopicDecisions]:
        """Which topics may be created; any of them may allow it."""
        return [TopicDecisions([(each.topics, each.allows) for each in steps], self._default) for steps in self._naming]

    def _matches(self, step: _CriteriaStep, partitions: Sequence[str], tags: Collection[tuple[str, str]]) -> bool:
        """Tell whether partitions and tags match: an allow rule needs all of the endpoint's, a deny rule one."""
        need = all if step.allows else any
        if step.tags is not None and self.semantics.tags_count and not need(tag in step.tags for tag in tags):
            return False
        return step.partitions is None or need(step.partitions.match(partition) for partition in partitions)

    def _by(self, step: _CriteriaStep, text: str, *, allowed: bool) -> Verdict:
        rule = "allow_rule" if step.allows else "deny_rule"
        return Verdict(allowed, f"the {rule} {text}", self._place(step.line))

    def _by_default(self, topic: str) -> Verdict:
        text = f"no rule matches {topic!r}, and the grant's default is {'ALLOW' if self._default else 'DENY'}"
        return Verdict(self._default, text, self._place(self._default_line))


def _grant(
    document: PermissionsDocument, subject_name: str, now: datetime, semantics: Semantics
) -> DocumentGrant | Verdict:
    """Return the grant that applies, or why there is none."""
    if refused := semantics.refusal(document) or semantics.unmodelled(document):
        return Verdict(False, refused)
    reason = f"no grant applies to {subject_name!r}"
    where = None
    for grant in semantics.grants(document, subject_name):
        period = semantics.period(grant)
        if period is not None and period[0] <= now <= period[1]:
            return grant
        when = "is not valid yet" if period is not None and now < period[0] else "has expired"
        where = document.place(grant.line)
        reason = f"the grant of {subject_name!r} {when} ({grant.not_before.strip()} to {grant.not_after.strip()})"
    return Verdict(False, reason, where)


def _steps(rules: Iterable[DocumentRule], semantics: Semantics) -> Iterator[_CriteriaStep]:
    """Yield groups of criteria that are matched together: each alone, or all of an action."""
    for rule in rules:
        groups: dict[object, list[signed_permissions.DocumentCriteria]] = {}
        for number, criteria in enumerate(rule.criteria):
            groups.setdefault(criteria.action if semantics.pools_criteria else number, []).append(criteria)
        for group in groups.values():
            yield _step(rule, group, semantics)


def _step(
    rule: DocumentRule, group: Sequence[signed_permissions.DocumentCriteria], semantics: Semantics
) -> _CriteriaStep:
    unlisted = any(item.partitions is None for item in group)
    everywhere = not rule.allows and (semantics.deny_topic or (unlisted and not semantics.deny_default))
    partitions = (p for item in group for p in (DEFAULT_PARTITION if item.partitions is None else item.partitions))
    tags = None if any(item.tags is None for item in group) else frozenset(t for item in group for t in item.tags or ())
    return _CriteriaStep(
        rule.allows,
        group[0].action,
        _patterns((topic for item in group for topic in item.topics), semantics),
        None if everywhere else _patterns(partitions, semantics),
        tags,
        group[0].line,
    )


def _patterns(expressions: Iterable[str], semantics: Semantics) -> _Expressions:
    texts = frozenset(dialects.in_bytes(semantics.reads_text(expression)) for expression in expressions)
    plain = frozenset(text for text in texts if dialects.is_plain(text))
    wild = _compiled(tuple(sorted(texts - plain)), semantics.fnmatch) if texts - plain else None
    return _Expressions(plain, wild, frozenset(map(literal_prefix, texts - plain)))


@lru_cache(maxsize=4096)
def _compiled(patterns: tuple[str, ...], dialect: Dialect) -> re.Pattern[str]:
    return re.compile("|".join(f"(?:{dialects.translate(pattern, dialect)})" for pattern in patterns), re.DOTALL)


class DomainAccess:
    """Access control in one domain, as an implementation reads a governance document.

    Attributes:
        refusal: why the document is refused or not modelled, or an empty text.
        rule: the domain rule that applies, or None.
    """

    def __init__(self, document: GovernanceDocument, domain: int, semantics: Semantics) -> None:
        self._document = document
        self._domain = domain
        self._semantics = semantics
        self.refusal = semantics.refusal(document) or semantics.unmodelled(document)
        exact = semantics.min_only_is_exact
        self.rule = None if self.refusal else document.rule(domain, min_only_is_exact=exact)

    def admits(self, *, joins: bool) -> bool:
        """Tell whether the participant may join.

        Args:
            joins: a rule of the permissions, or their default, lets it join.
        """
        if joins or self.rule is None:
            return joins and not self.refusal
        return not self._semantics.needs_rule_to_join and self.rule.joins_without_rule

    def decide(self, evaluator: DocumentEvaluator, action: str, topic: str, partitions: Sequence[str] = ()) -> Verdict:
        """Decide about an endpoint by governance and permissions.

        Args:
            evaluator: evaluates the permissions.
            action: ``publish`` or ``subscribe``.
            topic: DDS topic name.
            partitions: partitions of the endpoint.
        """
        absent = self.absent(evaluator)
        if absent is not None or self.rule is None:
            return absent or Verdict(allowed=False, reason=self.refusal)
        rule, place = topic_rule(self.rule, topic, self._semantics), self._document.place
        if rule is None:
            return Verdict(False, f"no topic rule matches {topic!r}", place(self.rule.line))
        if not rule.controls(action):
            return Verdict(True, f"{ACCESS[action]} is false for {rule.expression!r}", place(rule.line))
        return evaluator.decide(action, topic, partitions, topic_checked=rule.controlled)

    def absent(self, evaluator: DocumentEvaluator) -> Verdict | None:
        """Return why there is no participant with any endpoint, or None."""
        if self.refusal:
            return Verdict(allowed=False, reason=self.refusal)
        if evaluator.refusal is not None:
            return evaluator.refusal
        if self.rule is None:
            reason = f"the governance does not apply to domain {self._domain}"
            return Verdict(False, reason, Origin(self._document.file))
        if not self.admits(joins=evaluator.joins):
            reason = f"the permissions allow nothing in domain {self._domain}, so that there is no participant"
            return Verdict(False, reason)
        return None


def topic_rule(domain_rule: DocumentDomainRule, topic: str, semantics: Semantics) -> DocumentTopicRule | None:
    """Return the first rule that matches a topic, or None; see :attr:`Semantics.topic_rules_both_ways`."""
    name, dialect = dialects.in_bytes(topic), semantics.fnmatch
    for rule in domain_rule.topic_rules:
        expression = dialects.in_bytes(rule.expression)
        if expression == "*" or re.fullmatch(dialects.translate(expression, dialect), name, re.DOTALL):
            return rule
        if semantics.topic_rules_both_ways and re.fullmatch(dialects.translate(name, dialect), expression, re.DOTALL):
            return rule
    return None
