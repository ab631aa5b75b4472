# SPDX-License-Identifier: Apache-2.0
"""Decide about an endpoint by both documents: the governance determines whether the permissions are checked at all.

DDS Security 1.1, 9.4.3: the participant must be allowed to join; then the first topic rule that matches the topic
determines whether permissions are checked. A topic without a rule is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from comarmor.errors import Origin
from keymint_ros2_dds.decision import fnmatch_dialects
from keymint_ros2_dds.decision.evaluator import DecisionOutcome, DocumentEvaluator, EndpointDecision
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.reading.signed_governance import ACCESS, DocumentDomainRule, DocumentTopicRule, GovernanceDocument


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

    def decide(
        self, evaluator: DocumentEvaluator, action: str, topic: str, partitions: Sequence[str] = ()
    ) -> EndpointDecision:
        """Decide about an endpoint by governance and permissions.

        Args:
            evaluator: evaluates the permissions.
            action: ``publish`` or ``subscribe``.
            topic: DDS topic name.
            partitions: partitions of the endpoint.
        """
        absent = self.absent(evaluator)
        if absent is not None or self.rule is None:
            return absent or EndpointDecision(DecisionOutcome.ERROR, 0, self.refusal)
        rule = topic_rule(self.rule, topic, self._semantics)
        if rule is None:
            where = self._document.place(self.rule.line)
            return EndpointDecision(DecisionOutcome.DENIED, 0, f"no topic rule matches {topic!r}", where)
        if not rule.controls(action):
            where = self._document.place(rule.line)
            reason = f"{ACCESS[action]} is false for {rule.expression!r}"
            return EndpointDecision(DecisionOutcome.ALLOWED, 0, reason, where)
        return evaluator.decide(action, topic, partitions, topic_checked=rule.controlled)

    def absent(self, evaluator: DocumentEvaluator) -> EndpointDecision | None:
        """Return why there is no participant with any endpoint, or None."""
        if self.refusal:
            return EndpointDecision(DecisionOutcome.ERROR, 0, self.refusal)
        if evaluator.refusal is not None:
            return evaluator.refusal
        if self.rule is None:
            reason = f"the governance does not apply to domain {self._domain}"
            return EndpointDecision(DecisionOutcome.DENIED, 0, reason, Origin(self._document.file))
        if not self.admits(joins=evaluator.joins):
            reason = f"the permissions allow nothing in domain {self._domain}, so that there is no participant"
            return EndpointDecision(DecisionOutcome.DENIED, 0, reason)
        return None


def topic_rule(domain_rule: DocumentDomainRule, topic: str, semantics: Semantics) -> DocumentTopicRule | None:
    """Return the first rule that matches a topic, or None; see :attr:`Semantics.topic_rules_both_ways`."""
    name, dialect = fnmatch_dialects.in_bytes(topic), semantics.fnmatch
    for rule in domain_rule.topic_rules:
        expression = fnmatch_dialects.in_bytes(rule.expression)
        if expression == "*" or re.fullmatch(fnmatch_dialects.translate(expression, dialect), name, re.DOTALL):
            return rule
        if semantics.topic_rules_both_ways and re.fullmatch(
            fnmatch_dialects.translate(name, dialect), expression, re.DOTALL
        ):
            return rule
    return None
