# SPDX-License-Identifier: Apache-2.0
"""Prove or refute the claims about one permissions document.

Claims are cached: an installed document was often just built.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from comarmor.patterns.decision_lists import ProofResult, Unknown, Witness
from comarmor.patterns.proofs import escapes
from comarmor.patterns.tokens import PatternError
from keymint.api import Claim, ComparisonTask, DomainRange, Proof, lazy
from keymint_ros2_dds.decision.semantics import VARIATIONS, Semantics, shipped_models
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import merged_domains
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.lowering.lowered_rules import Lowered, lower
from keymint_ros2_dds.lowering.name_mapping import TopicAction
from keymint_ros2_dds.proving import document_lists as lists, enclave_governance, octets
from keymint_ros2_dds.proving.enclave_governance import ACTIONS, EnclaveGovernance, unread_topic
from keymint_ros2_dds.proving.grant_periods import grant_periods
from keymint_ros2_dds.proving.questions import Counterexamples, ProofQuestion, Situation
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.reading.signed_governance import DocumentDomainRule

_domain_access = lazy("keymint_ros2_dds.decision.evaluator:DomainAccess")  # few governances say more than the usual
_ALWAYS = (
    "only the governance in the subject's own enclave applies: a participant's local checks read no other",
    "packets are protected as the governance requires: where it neither signs nor encrypts, the network is trusted",
    "a grant of the subject (for Cyclone DDS the first one) is valid at that time",
    "ROS names are mapped as the distribution documents it",
    "an endpoint has no data tags and one partition, whose name is text (of several, each must be permitted)",
    "relay is not covered",
)
_BETWEEN = "a denial in some partitions hides from the engine whether the topic may be created"


def assumptions() -> Mapping[str, Sequence[str]]:
    """Return the assumptions of all claims by model; see :meth:`keymint.api.Prover.assumptions`."""
    return {name: (each.reading, *each.assumptions, *_ALWAYS) for name, each in VARIATIONS.items()}


def models(distro: str = "") -> Mapping[str, str]:
    """Return the evidence of each model; see :meth:`keymint.api.BuildType.models`."""
    return {name: VARIATIONS[name].evidence for name in (shipped_models(distro) if distro else VARIATIONS)}


def prove_document(question: ProofQuestion, *, models: Sequence[str] | None = None) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        question: the document, and what it must permit.
        models: names of :data:`.semantics.VARIATIONS`; None: those that the distribution ships.
    """
    compare = _Comparator(question)
    names = shipped_models(question.task.distro) if models is None else models
    return tuple(claim for name in names for claim in _Model(question, compare, name).claims())


class _Comparator:
    """Compares the policy with decision lists of the document, once for all models with the same lists.

    Attributes:
        pairs: words have partitions.
        independent: no expression depends on the locale.
    """

    def __init__(self, question: ProofQuestion) -> None:
        self._question = question
        governed = () if question.governance is None else question.governance.document.domain_rules
        opens = any(rule.opens for rule in governed)
        self.pairs = opens or lists.has_partitions(question.lowered, question.document.grants)
        self._universe = octets.universe(pairs=self.pairs)
        self.independent = octets.is_independent(question.document, question.task.rules)
        self._policy = {action: lists.of_policy(question.lowered, action, pairs=self.pairs) for action in ACTIONS}
        self._known: dict[tuple[object, ...], ProofResult] = {}

    def of(self, situation: Situation, permitted: lists.Permitted) -> ProofResult:
        """Compare what the policy allows with what the document permits."""
        policy = self._policy[situation.action] if situation.inside else lists.NOTHING
        key = (policy, permitted)
        if key not in self._known:
            budget = self._question.budget()
            if self._question.since is None:
                found = lists.difference(policy, permitted, self._universe, budget)
            else:
                found = escapes(permitted.lists, policy, self._universe, budget)
                found = Witness(found.word, left=False) if isinstance(found, Witness) else found
            self._known[key] = found
        return self._known[key]


class _Model:
    """Makes the claims of one model."""

    def __init__(self, question: ProofQuestion, comparison: _Comparator, name: str) -> None:
        self._question = question
        self._comparison = comparison
        self._variation = VARIATIONS[name]
        self._semantics = semantics = self._variation.semantics
        self._governance = governance = question.governance
        self._refused = semantics.refusal(question.document)
        self._unmodelled = "" if self._refused else semantics.unmodelled(question.document)
        if governance is not None and not self._refused:
            self._refused = semantics.refusal(governance.document)
            if not self._refused:
                odd = semantics.unmodelled(governance.document) or unread_topic(governance.document, semantics)
                self._unmodelled = self._unmodelled or odd
        eras = () if self._refused else grant_periods(question.document, question.task.subject_name, semantics)
        self._eras = tuple(era for era in eras if question.since is None or era.end >= question.since)
        self._by_locale = ""
        if not comparison.independent:
            grants, rules = [era.grant for era in self._eras], question.task.rules
            unread, self._by_locale = octets.locale_dependence(question.document, grants, rules, semantics)
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
            yield from enclave_governance.governance_claims(self._question.task, self._governance, self._variation)

    def _rule(self, domain: int) -> DocumentDomainRule | None:
        """Return the rule of the governance for a domain; None also if the proof is about permissions only."""
        if self._governance is None:
            return None
        rule: DocumentDomainRule | None = _domain_access(self._governance.document, domain, self._semantics).rule
        return rule

    def _domains(self) -> Iterator[tuple[tuple[DomainRange, ...], bool]]:
        """Yield groups of domains with the same policy and rules, and whether the policy applies there."""
        grants = [era.grant for era in self._eras]
        # Rules for the same domains apply in the same ones.
        rules = {rule.domains: rule for grant in grants for rule in grant.rules}
        permits_more = self._semantics.default_counts and any(grant.allows for grant in grants)
        groups: dict[tuple[object, ...], list[DomainRange]] = {}
        for domains, inside, applying in self._question.domains(rules.values(), self._semantics):
            rule = self._rule(domains.first)
            opens = rule is not None and rule.opens
            # Without rules in the policy or the document there is nothing to compare.
            if inside or opens or (self._semantics.domains_count and (permits_more or any(applying))):
                accepted = None if self._governance is None else self._governance.accepted_rule(domains.first)
                groups.setdefault((inside, rule, accepted, applying), []).append(domains)
        for (applies, *_), group in groups.items():
            yield tuple(merged_domains(group)), bool(applies)

    def _claim(self, action: TopicAction, domains: tuple[DomainRange, ...], *, inside: bool) -> Claim:
        domain, semantics, governance = domains[0].first, self._semantics, self._governance
        rule = None if self._unmodelled else self._rule(domain)
        universe = octets.PAIRS if self._comparison.pairs else octets.TOPICS
        if rule is not None and semantics.topic_rules_both_ways and not lists.is_closed(rule, semantics):
            universe += f"; without {' '.join(lists.WILDCARDS)}, which topic rules of the governance are compared with"
        claim = partial(Claim, self._variation.name, action, domains, universe)
        if self._unmodelled:
            return claim(Proof.UNKNOWN, self._unmodelled)
        situations = [Situation(action, domain, inside, era) for era in self._eras or (None,)]
        try:
            outcomes = [
                (each, self._comparison.of(each, self._permitted(each, bound)))
                for each in situations
                for bound in semantics.bounds
            ]
        except PatternError as error:
            return claim(Proof.UNKNOWN, f"{self._question.document.file}: {error}")
        witnesses = [(each, outcome) for each, outcome in outcomes if isinstance(outcome, Witness)]
        if witnesses:
            return self._refuted(claim, sorted(witnesses, key=lambda pair: len(pair[1].word)))
        unknown = next((outcome for _, outcome in outcomes if isinstance(outcome, Unknown)), None)
        if unknown:
            return claim(Proof.UNKNOWN, unknown.reason, spent=True)
        if self._by_locale:
            return claim(Proof.UNKNOWN, self._by_locale)
        excepted = () if governance is None or rule is None else governance.excepted(rule, action, domain)
        return claim(Proof.PROVEN, excepted=tuple(excepted))

    def _permitted(self, situation: Situation, semantics: Semantics) -> lists.Permitted:
        """Return what is permitted while a grant is in force; without a grant nothing is."""
        if situation.era is None:
            return lists.NOTHING_PERMITTED
        action, domain, inside, grant = situation.action, situation.domain, situation.inside, situation.era.grant
        pairs, governance = self._comparison.pairs, self._governance
        own = lists.of_grant(grant, domain, action, semantics, pairs=pairs)
        if governance is None:
            return lists.Permitted(own)
        governed = _domain_access(governance.document, domain, semantics)
        if governed.rule is None:
            return lists.Permitted(own, lists.REFUSED) if inside else lists.Permitted(own)
        default = semantics.default_counts and grant.allows
        joins = default or any(rule.allows and semantics.applies(rule, domain) for rule in grant.rules)
        if not governed.admits(joins=joins):
            return lists.NOTHING_PERMITTED
        if lists.is_closed(governed.rule, semantics):
            return lists.Permitted(own)
        if not inside and not semantics.domains_count:
            own = (lists.NOTHING,)  # by assumption the permissions are not used there
        accepted = governance.accepted_rule(domain)
        exempt = lists.NOTHING if accepted is None else lists.regions(accepted, action, semantics, pairs=pairs).opened
        topics = lists.regions(governed.rule, action, semantics, pairs=pairs)
        return lists.Permitted(own, topics, exempt, semantics.topic_rules_both_ways)

    def _refuted(self, claim: Callable[..., Claim], witnesses: Sequence[tuple[Situation, Witness]]) -> Claim:
        """Return the claim with the shortest counterexample; between two bounds a witness may be none."""
        examples = Counterexamples(self._question, self._variation, self._refused, self._eras, self._comparison.pairs)
        is_exact = len(self._semantics.bounds) == 1
        for situation, witness in witnesses[:1] if is_exact else witnesses:
            example, defect = examples.of(situation, witness.word, permitted=not witness.left)
            if not defect:
                return claim(Proof.COUNTEREXAMPLE, "", example)
        return claim(Proof.UNKNOWN, defect if is_exact else _BETWEEN)


MOST = 10_000
"""Number of documents whose claims are cached."""

_proven: dict[bytes, tuple[tuple[object, ...], tuple[Claim, ...]]] = {}
"""What claims depend on besides a document and its governance, and the claims, by the digest of both."""


def prove_content(
    task: ComparisonTask,
    *,
    models: Sequence[str] | None = None,
    lowered: Lowered | None = None,
    governance: EnclaveGovernance | None = None,
) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        task: the document, and what it must permit.
        models: names of the models; None: those that the distribution of the task ships.
        lowered: the rules in terms of DDS, if known.
        governance: the governance of the enclave; None puts everything under access control.

    Raises:
        KeymintError: the document cannot be read, or a rule cannot be mapped.
    """
    names = shipped_models(task.distro) if models is None else tuple(models)
    if governance is not None and governance.transparent(task.domains):
        # A proof without governance holds for one that puts everything under access control.
        claims = prove_content(task, models=models, lowered=lowered)
        if all(claim.proof is Proof.PROVEN for claim in claims):
            return claims
    key, others = _key(task, names, b"" if governance is None else governance.key)
    known = _proven.get(key)
    if known and known[0] == others:
        return known[1]
    document = signed_permissions.read(task.document, task.file, task.offset)
    if not document.defects:
        dds_xml.know_valid(task.document, PERMISSIONS)
    question = ProofQuestion(document, task, lower(task.rules, task.distro) if lowered is None else lowered, governance)
    claims = prove_document(question, models=names)
    # Proofs do not depend on the place of the document; counterexamples name it.
    if all(claim.proof is Proof.PROVEN for claim in claims) and len(_proven) < MOST:
        _proven[key] = others, claims
    return claims


def remember(task: ComparisonTask, claims: tuple[Claim, ...]) -> None:
    """Remember what is proven about a document by the models that its distribution ships, under full access control.

    Args:
        task: the document, and what it must permit.
        claims: what is proven.
    """
    if len(_proven) < MOST:
        key, others = _key(task, shipped_models(task.distro), b"")
        _proven[key] = others, claims


def _key(task: ComparisonTask, models: tuple[str, ...], governance: bytes) -> tuple[bytes, tuple[object, ...]]:
    """Return the digest of a document and a governance, and all else that proven claims depend on."""
    digest, rules = hashlib.sha256(task.document).digest(), task.rules
    # To hash the rules costs more than to compare them with the same ones.
    return digest + governance, (rules.kind, task.subject_name, rules.subject, task.distro, task.domains, models)
