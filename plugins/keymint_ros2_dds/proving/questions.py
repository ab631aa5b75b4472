# SPDX-License-Identifier: Apache-2.0
"""What is to be proven about a document, and what the plain evaluators decide about a name on which it is wrong.

The policy is evaluated for one endpoint by its rules, independent of the compiler's translation, to check it. An
endpoint is a raw topic, and may be part of ROS entities; rules that match any of these apply.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from datetime import datetime

from comarmor.patterns import glob
from comarmor.patterns.decision_lists import SearchBudget
from comarmor.patterns.glob import matches
from comarmor.rules import Effect, is_fully_qualified, parts
from comarmor.values import Data, replace
from keymint import api
from keymint.api import ComparisonTask, Counterexample, DomainRange, PolicyDecision, lazy
from keymint.errors import Reason
from keymint.ir import Rule, SubjectRules
from keymint_ros2_dds.decision import semantics
from keymint_ros2_dds.decision.semantics import Semantics, Variation
from keymint_ros2_dds.lowering.lowered_rules import Lowered
from keymint_ros2_dds.lowering.name_mapping import ARDENT, TopicAction
from keymint_ros2_dds.proving import enclave_governance, octets
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance, cuts
from keymint_ros2_dds.proving.grant_periods import GrantPeriod
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.signed_permissions import DocumentRule, PermissionsDocument

# Only a name on which a document is wrong is evaluated.
_meanings = lazy("keymint_ros2_dds.lowering.endpoints:meanings")
_document_evaluator = lazy("keymint_ros2_dds.decision.evaluator:DocumentEvaluator")
_domain_access = lazy("keymint_ros2_dds.decision.evaluator:DomainAccess")


class ProofQuestion(Data):
    """A permissions document, and what it must permit.

    Attributes:
        document: the document.
        task: its bytes, and what it must permit.
        lowered: its rules in terms of DDS, from :func:`keymint_ros2_dds.lowering.lowered_rules.lower`.
        governance: the governance beside it; None puts every topic, and joining, under access control.
        since: the document must permit no more than the policy from this time on, UTC; None: exactly it, at any time.
    """

    document: PermissionsDocument
    task: ComparisonTask
    lowered: Lowered
    governance: EnclaveGovernance | None = None
    since: datetime | None = None

    def domains(
        self, rules: Collection[DocumentRule], semantics: Semantics
    ) -> Iterator[tuple[DomainRange, bool, tuple[bool, ...]]]:
        """Yield domains that nothing tells apart, whether the policy applies there, and which rules of grants do."""
        governed = () if self.governance is None else self.governance.domains()
        for domains in cuts((*self.task.domains, *(each for rule in rules for each in rule.domains), *governed)):
            inside = any(each.first <= domains.first <= each.last for each in self.task.domains)
            yield domains, inside, tuple(semantics.applies(rule, domains.first) for rule in rules)

    def budget(self) -> SearchBudget:
        """Return the limits of a search for one answer."""
        return SearchBudget(self.task.states, self.task.go_on)


def is_ros_name(name: str) -> bool:
    """Whether a topic or service may have a fully qualified name (ROS 2 design, "Topic and Service Names")."""
    return is_fully_qualified(name) and "__" not in name


def deciding_rule(rules: SubjectRules, distro: str, action: str, topic: str, partition: str) -> Rule | None:
    """Return the rule that decides about an endpoint: the first denial, else the first match, else None."""
    edges = endpoint_edges(rules.subject, distro, action, topic, partition)
    about = [rule for rule in rules.rules if any(_is_about(rule, edge, partition) for edge in edges)]
    return next((rule for rule in about if rule.effect is Effect.DENY), about[0] if about else None)


def endpoint_edges(subject: str, distro: str, action: str, topic: str, partition: str) -> tuple[api.Edge, ...]:
    """Return the edge of an endpoint, and those of the ROS entities that need it."""
    partitions = (partition,) if partition or distro == ARDENT else ()
    endpoint = api.Edge(subject, action, api.Object("topic", topic, partitions))
    return (endpoint, *_meanings(distro, endpoint))


def _is_about(rule: Rule, edge: api.Edge, partition: str) -> bool:
    """Tell whether a rule matches an edge; a composite rule matches its name without the suffix of its part."""
    if rule.partitions:
        if not any(_matches(expression, partition) for expression in rule.partitions):
            return False
    elif rule.effect is not Effect.DENY and any(edge.object.partitions):
        return False  # an edge on a ROS name of Ardent has its partition in its name
    name = edge.object.name
    needed = (each for permission in rule.permissions for each in parts(rule.kind, permission))
    suffixes = [end for kind, part, end in needed if (kind, part) == (edge.object.kind, edge.permission)]
    names = [name.removesuffix(end) for end in suffixes if name.endswith(end)]
    return any(_matches(expression, each) for each in names for expression in rule.expressions)


def _matches(expression: str, name: str) -> bool:
    """Tell whether an expression matches a name, byte by byte."""
    return matches(octets.of_glob(glob.parse(expression)), dialects.in_bytes(name))


_DATE = "%Y-%m-%dT%H:%M:%S"


class Situation(Data):
    """When two decisions are compared.

    Attributes:
        action: what somebody tries to do.
        domain: DDS domain id.
        inside: the policy applies in that domain.
        era: the grant in force, and its period; None if none ever is.
    """

    action: TopicAction
    domain: int
    inside: bool
    era: GrantPeriod | None


class Counterexamples(Data):
    """Makes counterexamples to the claims of one model.

    Attributes:
        question: the document, and what it must permit.
        variation: the model.
        refused: why the model reads no document at all, or an empty text.
        eras: the periods in which a grant is in force.
        pairs: words have partitions.
    """

    question: ProofQuestion
    variation: Variation
    refused: str
    eras: tuple[GrantPeriod, ...]
    pairs: bool

    def of(self, situation: Situation, word: str, *, permitted: bool) -> tuple[Counterexample, str]:
        """Return a name for which the policy and the documents decide differently, with both decisions.

        The second value tells that the engine and the plain evaluators disagree; it is empty if they agree.

        Args:
            situation: when they differ.
            word: the name, and its partition, in the alphabet of the engine.
            permitted: the engine finds that the documents permit it.
        """
        task, governance = self.question.task, self.question.governance
        action, domain = situation.action, situation.domain
        pair = word.split(octets.SEPARATOR) if self.pairs else ("", word)
        partition, topic = map(octets.in_text, pair)
        edges = endpoint_edges(task.rules.subject, task.distro, action, topic, partition)
        policy = self._policy_decision(situation, topic, partition, permitted=permitted)
        verdict = self._verdict(situation, topic, partition, permitted=permitted)
        place, help_ = None, ""
        if governance is not None and verdict.where is not None and verdict.where.file == governance.document.file:
            place, help_ = verdict.where, enclave_governance.help_for(governance, domain)
        endpoint = api.Endpoint(task.rules.subject, action, topic, edges[0].object.partitions, domain)
        entity = next((edge for edge in edges[1:] if is_ros_name(edge.object.name)), None)
        example = Counterexample(endpoint, entity, policy, verdict, help_, place)
        agree = policy.allowed is not permitted and verdict.allowed is permitted
        defect = f"the engine and the plain evaluators disagree on {topic!r}: a defect of Keymint"
        return example, "" if agree else defect

    def _verdict(self, situation: Situation, topic: str, partition: str, *, permitted: bool) -> api.Verdict:
        """Return the verdict of the decision point about a topic and partition, by this model.

        Where the engine finds it permitted, the permissions alone may do so: a peer evaluates its own governance.
        """
        question, governance, era = self.question, self.question.governance, situation.era
        if self.refused:
            return api.Verdict(allowed=False, reason=self.refused)
        if era is None:
            return self._never()
        now, domain = era.begin, situation.domain
        endpoint = situation.action, topic, (partition,) if partition else ()

        def ask(variation: Variation) -> api.Verdict:
            evaluator = _document_evaluator(question.document, question.task.subject_name, now, domain, variation)
            alone: api.Verdict = evaluator.decide(*endpoint)
            if governance is None:
                return alone
            outcome: api.Verdict = _domain_access(governance.document, domain, variation.semantics).decide(
                evaluator, *endpoint
            )
            if not outcome.allowed and permitted and alone.allowed:
                reason = f"{alone.reason}; only the governance of this enclave refuses it: peers evaluate their own"
                return replace(alone, reason=reason)
            return outcome

        outcome = ask(self.variation)
        deviation = "; ".join(map(str, semantics.explain(lambda other: ask(other).allowed, self.variation)))
        reason = outcome.reason
        if len(self.eras) > 1:
            reason += f" (by the grant in force from {era.begin:{_DATE}} to {era.end:{_DATE}})"
        return api.Verdict(outcome.allowed, reason, outcome.where, deviation)

    def _never(self) -> api.Verdict:
        """Return why no grant is ever in force."""
        document, name = self.question.document, self.question.task.subject_name
        grant = next(iter(self.variation.semantics.grants(document, name)), None)
        if grant is None:
            return api.Verdict(allowed=False, reason=f"no grant applies to {name!r}")
        dates = f"{grant.not_before.strip()} to {grant.not_after.strip()}"
        reason = f"the grant of {name!r} is never valid ({dates})"
        return api.Verdict(allowed=False, reason=reason, where=document.place(grant.line))

    def _policy_decision(self, situation: Situation, topic: str, partition: str, *, permitted: bool) -> PolicyDecision:
        if situation.action == "relay":  # the evaluator of policies knows no relay
            verb = "allow" if situation.inside and not permitted else "do not allow"
            return PolicyDecision(allowed=not permitted, where=None, reason=Reason((f"the rules {verb} it",)))
        if not situation.inside:
            return PolicyDecision(allowed=False, where=None, reason=Reason(("not its domain",)))
        task = self.question.task
        rule = deciding_rule(task.rules, task.distro, situation.action, topic, partition)
        if rule is None:
            return PolicyDecision(allowed=False, where=None, reason=Reason(("no rule allows it",)))
        allowed = rule.effect is Effect.ALLOW
        verb = "allows" if allowed else "denies"
        return PolicyDecision(allowed, rule.origin, Reason((f"the {rule.kind} rule {verb} it",)), rule.audit)
