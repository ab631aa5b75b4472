# SPDX-License-Identifier: Apache-2.0
"""Prove or refute the claims about one permissions document."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType

from comarmor.patterns.decision_lists import (
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
)
from comarmor.patterns.tokens import PatternError
from keymint.api import Claim, Counterexample, DomainRange, Proof
from keymint_ros2_dds.decision import VARIATIONS
from keymint_ros2_dds.decision.access import DomainAccess
from keymint_ros2_dds.domains import merged
from keymint_ros2_dds.proving import octets, protection
from keymint_ros2_dds.proving.comparison import NOTHING_PERMITTED, Comparator, Permitted
from keymint_ros2_dds.proving.counterexamples import Counterexamples
from keymint_ros2_dds.proving.enclave_governance import ACTIONS, cuts
from keymint_ros2_dds.proving.governance_lists import (
    NOTHING,
    REFUSED,
    WILDCARDS,
    regions,
)
from keymint_ros2_dds.proving.grant_periods import GrantPeriod, grant_periods
from keymint_ros2_dds.proving.questions import ProofQuestion
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains, DocumentGrant

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


def prove_document(question: ProofQuestion, *, models: Sequence[str] | None = None) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        question: the document, and what it must permit.
        models: names of the models, of :data:`ASSUMPTIONS`; None: all.
    """
    compare = Comparator(question)
    names = ASSUMPTIONS if models is None else models
    return tuple(claim for name in names for claim in _Model(question, compare, name).claims())


_Claiming = Callable[..., Claim]


class _Model:
    """Makes the claims of one model."""

    def __init__(self, question: ProofQuestion, comparison: Comparator, name: str) -> None:
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
        permitted = NOTHING_PERMITTED if era is None else self._permitted(era.grant, action, domain, inside=inside)
        return self._comparison.of(action, permitted, inside=inside)

    def _permitted(self, grant: DocumentGrant, action: str, domain: int, *, inside: bool) -> Permitted:
        """Return what is permitted while a grant is in force."""
        pairs, semantics = self._comparison.pairs, self._semantics
        own = self._comparison.lists.of(grant, domain, action, semantics)
        governed = self._rule(domain)
        if governed is None or self._governance is None:
            return Permitted(own)
        default = semantics.default_counts and grant.allows
        joins = default or any(rule.allows and semantics.applies(rule, domain) for rule in grant.rules)
        if governed.rule is None:
            return Permitted(own, REFUSED) if inside else Permitted(own)
        if not governed.admits(joins=joins):
            return NOTHING_PERMITTED
        topics = regions(governed.rule, action, semantics, pairs=pairs)
        if topics.closed:
            return Permitted(own)
        if not inside and not semantics.domains_count:
            own = (NOTHING,)  # by assumption the permissions are not used there
        accepted = self._governance.accepted_rule(domain)
        exempt = NOTHING if accepted is None else regions(accepted, action, semantics, pairs=pairs).opened
        return Permitted(own, topics, exempt, semantics.topic_rules_both_ways)

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
        examples = Counterexamples(self._question, self._variation, self._refused, self._eras, self._comparison.pairs)
        example = examples.of(action, domain, era, witness.word, inside=inside, permitted=not witness.left)
        if example.policy.allowed is not witness.left or example.document.allowed is witness.left:
            name = example.endpoint.name
            return claim(
                Proof.UNKNOWN, f"the engine and the plain evaluators disagree on {name!r}: a defect of Keymint"
            )
        return claim(Proof.COUNTEREXAMPLE, "", example)
