# SPDX-License-Identifier: Apache-2.0
"""Prove or refute the claims about one permissions document."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from comarmor.errors import Reason
from comarmor.patterns.decision_lists import (
    DecisionList,
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
)
from comarmor.patterns.proofs import difference
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint.api import Claim, Counterexample, DomainRange, Endpoint, PolicyDecision, Proof, Verdict
from keymint.ir import SubjectRules
from keymint_ros2_dds import decision
from keymint_ros2_dds.decision import OMG, VARIATIONS, DocumentEvaluator, EndpointDecision, Variation
from keymint_ros2_dds.decision.access import DomainAccess
from keymint_ros2_dds.domains import merged
from keymint_ros2_dds.lowering.lower import Lowered
from keymint_ros2_dds.proving import octets, permission_lists, policy_evaluator, protection
from keymint_ros2_dds.proving.enclave_governance import ACTIONS, EnclaveGovernance, cuts
from keymint_ros2_dds.proving.governance_lists import (
    NOTHING,
    REFUSED,
    WILDCARDS,
    Regions,
    regions,
    without_wildcards,
)
from keymint_ros2_dds.proving.governance_lists import difference as governed_difference
from keymint_ros2_dds.proving.grant_periods import GrantPeriod, grant_periods
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains, DocumentGrant, PermissionsDocument

_ALWAYS = (
    "only the governance in the subject's own enclave applies: a participant's local checks read no other",
    "packets are protected as the governance requires: where it neither signs nor encrypts, the network is trusted",
    "a grant of the subject (for Cyclone DDS the first one) is valid at that time",
    "ROS names are mapped as the distribution documents it",
    "an endpoint has no data tags and one partition, whose name is text (of several, each must be permitted)",
    "relay is not covered",
)
ASSUMPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "omg": ("documents are read as DDS Security 1.1 specifies (9.4.1.3)", *_ALWAYS),
        "cyclonedds-0.10": (
            "documents are read as Cyclone DDS 0.10.2 was measured to read them; its topic check is part of the model",
            "no application creates built-in topics (DCPS…): Cyclone DDS does not check these",
            *_ALWAYS,
        ),
        "fastdds-2.9": (
            "documents are read as Fast DDS 2.9.1 was measured to read them",
            "non-ASCII names are compared by byte (C locale); other locales (Python sets one) also compare characters",
            "participants join only the domains of the policy: local checks ignore the domains in permissions",
            "the local time zone is UTC: Fast DDS reads the dates of a grant as local time",
            *_ALWAYS,
        ),
    }
)


@dataclass(frozen=True, slots=True)
class ProofSpec:
    """What a permissions document must permit, and how long a proof may take.

    Attributes:
        subject_name: the identity's, in the order of RFC 2253, e.g. ``CN=/talker,OU=0f``.
        rules: the policy's rules for the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the policy applies.
        states: how many states a comparison may visit.
        go_on: called repeatedly; a comparison ends as unknown when it returns False.
    """

    subject_name: str
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    states: int
    go_on: Callable[[], bool]


@dataclass(frozen=True, slots=True)
class ProofQuestion:
    """A permissions document, and what it must permit.

    Attributes:
        document: the document.
        spec: what it must permit.
        lowered: its rules in terms of DDS, from :func:`keymint_ros2_dds.lowering.lower.lower`.
        governance: the governance beside it; None puts every topic, and joining, under access control.
    """

    document: PermissionsDocument
    spec: ProofSpec
    lowered: Lowered
    governance: EnclaveGovernance | None = None


def prove_document(question: ProofQuestion, *, models: Sequence[str] | None = None) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        question: the document, and what it must permit.
        models: names of the models, of :data:`ASSUMPTIONS`; None: all.
    """
    compare = _Comparator(question)
    names = ASSUMPTIONS if models is None else models
    return tuple(claim for name in names for claim in _Model(question, compare, name).claims())


_Claiming = Callable[..., Claim]
_DATE = "%Y-%m-%dT%H:%M:%S"


@dataclass(frozen=True, slots=True)
class _Permitted:
    """What the documents permit.

    Attributes:
        lists: decision lists of the permissions, of which all must permit.
        regions: topics by their governance; None if every topic is under access control.
        exempt: permits the topics that the sources leave open, as the profile accepts.
        both_ways: names with wildcards are excluded, because topic rules match them in both directions.
    """

    lists: tuple[DecisionList, ...]
    regions: Regions | None = None
    exempt: DecisionList = NOTHING
    both_ways: bool = False


_NONE = _Permitted((NOTHING,))


class _Comparator:
    """Compares the policy with decision lists of the document, once for all models with the same lists.

    Attributes:
        pairs: words have partitions.
        lists: the decision lists of the document.
        independent: no expression depends on the locale.
    """

    def __init__(self, question: ProofQuestion) -> None:
        self._question = question
        opens = question.governance is not None and question.governance.opens()
        self.pairs = opens or permission_lists.has_partitions(question.lowered, question.document.grants)
        self._universe = Universe(
            octets.ALPHABET, fields=2 if self.pairs else 1, separator=permission_lists.SEPARATOR, last_nonempty=True
        )
        self.lists = permission_lists.GrantLists(question.document.grants, pairs=self.pairs)
        self.independent = octets.is_independent(question.document, question.spec.rules)
        self._policy = {
            action: permission_lists.of_policy(question.lowered, action, pairs=self.pairs) for action in ACTIONS
        }
        self._known: dict[tuple[object, ...], ProofResult] = {}

    def of(self, action: str, permitted: _Permitted, *, inside: bool) -> ProofResult:
        """Compare what the policy allows, in its domains or elsewhere, with what the document permits."""
        policy = self._policy[action] if inside else ()
        key = (policy, permitted)
        result = self._known.get(key)
        if result is None:
            budget = SearchBudget(self._question.spec.states, self._question.spec.go_on)
            result = self._known[key] = self._compared(policy, permitted, budget)
        return result

    def _compared(self, policy: DecisionList, permitted: _Permitted, budget: SearchBudget) -> ProofResult:
        if permitted.regions is None:
            return difference(policy, *permitted.lists, universe=self._universe, budget=budget)
        universe = without_wildcards(self._universe) if permitted.both_ways else self._universe
        return governed_difference(policy, permitted.lists, permitted.regions, permitted.exempt, universe, budget)


class _Model:
    """Makes the claims of one model."""

    def __init__(self, question: ProofQuestion, comparison: _Comparator, name: str) -> None:
        self._question = question
        self._comparison = comparison
        self._variation = VARIATIONS[name]
        self._semantics = VARIATIONS[name].semantics
        self._refused = self._semantics.refusal(question.document)
        self._unmodelled = "" if self._refused else self._semantics.unmodelled(question.document)
        self._governance = question.governance
        self._governed: dict[int, DomainAccess] = {}
        if self._governance is not None:
            self._refused = self._refused or self._semantics.refusal(self._governance.document)
            if not self._refused:
                document = self._governance.document
                odd = self._semantics.unmodelled(document) or self._governance.outlandish()
                self._unmodelled = self._unmodelled or odd
        self._eras = (
            ()
            if self._refused
            else tuple(grant_periods(question.document, question.spec.subject_name, self._semantics))
        )
        self._by_locale = ""
        if not comparison.independent:
            grants = [era.grant for era in self._eras]
            unread, self._by_locale = octets.locale_dependence(
                question.document, grants, question.spec.rules, self._semantics
            )
            self._unmodelled = self._unmodelled or unread

    def claims(self) -> Iterator[Claim]:
        groups = tuple(self._domains())
        for action in ACTIONS:
            for domains, inside in groups:
                claim = self._claim(action, domains, inside=inside)
                # That nothing is permitted outside of the policy's domains is reported only where it is wrong.
                if inside or claim.proof is not Proof.PROVEN:
                    yield claim
        if self._governance is not None and not self._refused and not self._unmodelled:
            names = Universe(octets.ALPHABET, last_nonempty=True)
            subject, model = self._question.spec.rules.subject, self._variation.name
            yield from protection.claims(subject, model, self._semantics, self._governance, names, self._budget())

    def _budget(self) -> SearchBudget:
        return SearchBudget(self._question.spec.states, self._question.spec.go_on)

    def _rule(self, domain: int) -> DomainAccess | None:
        """Return the access control in a domain; None if the proof is about permissions only."""
        if self._governance is None:
            return None
        access = self._governed.get(domain)
        if access is None:
            access = self._governed[domain] = DomainAccess(self._governance.document, domain, self._semantics)
        return access

    def _domains(self) -> Iterator[tuple[tuple[DomainRange, ...], bool]]:
        """Yield groups of domains with the same policy and rules, and whether the policy applies there."""
        wanted = self._question.spec.domains
        grants = [era.grant for era in self._eras]
        # Rules for the same domains apply in the same ones.
        rules = {rule.domains: rule for grant in grants for rule in grant.rules}
        ranges = [DocumentDomains(domains.first, domains.last) for domains in wanted]
        ranges += (domains for each in rules for domains in each)
        ranges += () if self._governance is None else self._governance.domains()
        permits_more = self._semantics.default_counts and any(grant.allows for grant in grants)
        groups: dict[tuple[object, ...], list[DomainRange]] = {}
        for domains in cuts(ranges):
            first = domains.first
            inside = any(d.first <= first <= d.last for d in wanted)
            applying = [self._semantics.applies(rule, first) for rule in rules.values()]
            governed = self._rule(first)
            rule = None if governed is None else governed.rule
            opens = rule is not None and any(
                not topic_rule.controls(action) for topic_rule in rule.topic_rules for action in ACTIONS
            )
            # Without rules in the policy or the document there is nothing to compare.
            if inside or opens or (self._semantics.domains_count and (permits_more or any(applying))):
                accepted = None if self._governance is None else self._governance.accepted_rule(first)
                groups.setdefault((inside, rule, accepted, *applying), []).append(domains)
        for (applies, *_), group in groups.items():
            yield tuple(merged(group)), bool(applies)

    def _claim(self, action: str, domains: tuple[DomainRange, ...], *, inside: bool) -> Claim:
        universe = octets.PAIRS if self._comparison.pairs else octets.TOPICS
        if self._both_ways(domains[0].first, action):
            universe += f"; without {' '.join(WILDCARDS)}, which topic rules of the governance are compared with"

        def claim(
            proof: Proof, reason: str = "", counterexample: Counterexample | None = None, *, spent: bool = False
        ) -> Claim:
            excepted = self._excepted(action, domains[0].first) if proof is Proof.PROVEN else ()
            name = self._variation.name
            return Claim(name, action, domains, universe, proof, reason, counterexample, spent, excepted)

        if self._unmodelled:
            return claim(Proof.UNKNOWN, self._unmodelled)
        domain = domains[0].first
        try:
            outcomes = [(era, self._compare(era, action, domain, inside=inside)) for era in self._eras or (None,)]
        except PatternError as error:
            return claim(Proof.UNKNOWN, f"{self._question.document.file}: {error}")
        witnesses = [(era, outcome) for era, outcome in outcomes if isinstance(outcome, Witness)]
        if witnesses:
            era, witness = min(witnesses, key=lambda pair: len(pair[1].word))
            return self._refuted(claim, action, domain, era, witness, inside=inside)
        unknown = next((outcome for _, outcome in outcomes if isinstance(outcome, Unknown)), None)
        if unknown:
            return claim(Proof.UNKNOWN, unknown.reason, spent=True)
        return claim(Proof.UNKNOWN, self._by_locale) if self._by_locale else claim(Proof.PROVEN)

    def _compare(self, era: GrantPeriod | None, action: str, domain: int, *, inside: bool) -> ProofResult:
        """Compare the policy with what is permitted while a grant is in force; without a grant nothing is."""
        permitted = _NONE if era is None else self._permitted(era.grant, action, domain, inside=inside)
        return self._comparison.of(action, permitted, inside=inside)

    def _permitted(self, grant: DocumentGrant, action: str, domain: int, *, inside: bool) -> _Permitted:
        """Return what is permitted while a grant is in force."""
        pairs, semantics = self._comparison.pairs, self._semantics
        own = self._comparison.lists.of(grant, domain, action, semantics)
        governed = self._rule(domain)
        if governed is None or self._governance is None:
            return _Permitted(own)
        default = semantics.default_counts and grant.allows
        joins = default or any(rule.allows and semantics.applies(rule, domain) for rule in grant.rules)
        if governed.rule is None:
            return _Permitted(own, REFUSED) if inside else _Permitted(own)
        if not governed.admits(joins=joins):
            return _NONE
        topics = regions(governed.rule, action, semantics, pairs=pairs)
        if topics.closed:
            return _Permitted(own)
        if not inside and not semantics.domains_count:
            own = (NOTHING,)  # by assumption the permissions are not used there
        accepted = self._governance.accepted_rule(domain)
        exempt = NOTHING if accepted is None else regions(accepted, action, semantics, pairs=pairs).opened
        return _Permitted(own, topics, exempt, semantics.topic_rules_both_ways)

    def _both_ways(self, domain: int, action: str) -> bool:
        """Tell whether a claim excludes names with wildcards."""
        governed = self._rule(domain)
        if governed is None or governed.rule is None or not self._semantics.topic_rules_both_ways:
            return False
        return not regions(governed.rule, action, self._semantics, pairs=self._comparison.pairs).closed

    def _excepted(self, action: str, domain: int) -> tuple[str, ...]:
        governed = self._rule(domain)
        if self._governance is None or governed is None or governed.rule is None:
            return ()
        return tuple(self._governance.excepted(governed.rule, action, domain))

    def _refuted(
        self, claim: _Claiming, action: str, domain: int, era: GrantPeriod | None, witness: Witness, *, inside: bool
    ) -> Claim:
        example = self._counterexample(action, domain, era, witness.word, inside=inside, permitted=not witness.left)
        if example.policy.allowed is not witness.left or example.document.allowed is witness.left:
            name = example.endpoint.name
            return claim(
                Proof.UNKNOWN, f"the engine and the plain evaluators disagree on {name!r}: a defect of Keymint"
            )
        return claim(Proof.COUNTEREXAMPLE, "", example)

    def _counterexample(
        self, action: str, domain: int, era: GrantPeriod | None, word: str, *, inside: bool, permitted: bool
    ) -> Counterexample:
        spec = self._question.spec
        pair = word.split(permission_lists.SEPARATOR) if self._comparison.pairs else ("", word)
        partition, topic = map(octets.in_text, pair)
        rules = spec.rules if inside else SubjectRules(spec.rules.subject, ())
        edges = policy_evaluator.endpoint_edges(rules.subject, spec.distro, action, topic, partition)
        rule = policy_evaluator.decide(rules, spec.distro, action, topic, partition)
        if rule is not None:
            verb = "allows" if rule.effect is Effect.ALLOW else "denies"
            policy = PolicyDecision(
                rule.effect is Effect.ALLOW, rule.origin, Reason((f"the {rule.kind} rule {verb} it",)), rule.audit
            )
        else:
            reason = "no rule allows it" if inside else "not its domain"
            policy = PolicyDecision(allowed=False, where=None, reason=Reason((reason,)))
        verdict = self._verdict(action, domain, era, (topic, partition), permitted=permitted)
        by_governance = (
            self._governance is not None
            and verdict.where is not None
            and verdict.where.file == self._governance.document.file
        )
        return Counterexample(
            Endpoint(rules.subject, action, topic, edges[0].object.partitions, domain),
            next((edge for edge in edges[1:] if policy_evaluator.is_ros_name(edge.object.name)), None),
            policy,
            verdict,
            protection.help_for(self._governance, domain) if by_governance else "",
            verdict.where if by_governance else None,
        )

    def _verdict(
        self, action: str, domain: int, era: GrantPeriod | None, name: tuple[str, str], *, permitted: bool
    ) -> Verdict:
        """Return the verdict of the decision point about a topic and partition, by this model.

        Where the engine finds it permitted, the permissions alone may do so: a peer evaluates its own governance.
        """
        question, (topic, partition) = self._question, name
        if self._refused:
            return Verdict(allowed=False, reason=self._refused)
        if era is None:
            return self._never()
        now = era.begin

        def ask(variation: Variation) -> EndpointDecision:
            evaluator = DocumentEvaluator(question.document, question.spec.subject_name, now, domain, variation)
            partitions = (partition,) if partition else ()
            if self._governance is None:
                return evaluator.decide(action, topic, partitions)
            governed = DomainAccess(self._governance.document, domain, variation.semantics)
            outcome = governed.decide(evaluator, action, topic, partitions)
            if not outcome.allowed and permitted and (alone := evaluator.decide(action, topic, partitions)).allowed:
                reason = f"{alone.reason}; only the governance of this enclave refuses it: peers evaluate their own"
                return replace(alone, reason=reason)
            return outcome

        outcome = ask(self._variation)
        deviation = ""
        if self._variation.name != OMG.name and ask(OMG).allowed is not outcome.allowed:
            deviation = "; ".join(map(str, decision.explain(lambda other: ask(other).allowed, self._variation)))
        reason = outcome.reason
        if len(self._eras) > 1:
            reason += f" (by the grant in force from {era.begin:{_DATE}} to {era.end:{_DATE}})"
        return Verdict(outcome.allowed, reason, outcome.where, deviation)

    def _never(self) -> Verdict:
        """Return why no grant is ever in force."""
        document, name = self._question.document, self._question.spec.subject_name
        grant = next(iter(self._semantics.grants(document, name)), None)
        if grant is None:
            return Verdict(allowed=False, reason=f"no grant applies to {name!r}")
        dates = f"{grant.not_before.strip()} to {grant.not_after.strip()}"
        reason = f"the grant of {name!r} is never valid ({dates})"
        return Verdict(allowed=False, reason=reason, where=document.place(grant.line))
