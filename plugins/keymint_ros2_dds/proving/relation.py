# SPDX-License-Identifier: Apache-2.0
"""Compare a permissions document with rules in both directions: what it lacks, and what it permits beyond them.

The standard's reading decides (DDS Security 1.1, 9.4.1.3). Relay is compared as well. The governance is not: all
topics count as under access control.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from comarmor.errors import Reason
from comarmor.patterns.decision_lists import DecisionList, SearchBudget, Universe, Unknown, Witness
from comarmor.patterns.proofs import implies
from comarmor.patterns.tokens import PatternError
from comarmor.values import dataclass
from keymint.api import (
    ComparisonTask,
    Counterexample,
    DocumentComparison,
    DomainRange,
    PolicyDecision,
    Relation,
)
from keymint.errors import KeymintError
from keymint_ros2_dds.decision import OMG, read
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.lower import lower
from keymint_ros2_dds.proving import octets, permission_lists
from keymint_ros2_dds.proving.counterexamples import Counterexamples
from keymint_ros2_dds.proving.enclave_governance import cuts
from keymint_ros2_dds.proving.governance_lists import NOTHING
from keymint_ros2_dds.proving.grant_periods import GrantPeriod, grant_periods
from keymint_ros2_dds.proving.questions import ProofQuestion, ProofSpec
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains, PermissionsDocument

_SEMANTICS = OMG.semantics


def compared(task: ComparisonTask) -> DocumentComparison:
    """Compare a document with rules; see :meth:`keymint.api.DocumentComparer.compared`.

    Raises:
        KeymintError: a rule cannot be mapped.
    """
    lowered = lower(task.rules, task.distro)
    try:
        document = read(task.document, task.file, task.offset)
    except KeymintError as error:
        return DocumentComparison(Relation.UNKNOWN, reason=str(error))
    if refused := _SEMANTICS.refusal(document):
        return DocumentComparison(Relation.UNKNOWN, reason=refused)
    spec = ProofSpec(task.subject_name, task.rules, task.distro, task.domains, task.states, task.go_on)
    return _Comparison(ProofQuestion(document, spec, lowered), document).result()


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a right is: an action, a domain, and the period of a grant; None if no grant is ever in force."""

    action: str
    domain: int
    inside: bool
    era: GrantPeriod | None


class _Comparison:
    """Compares a document with the rules of a question."""

    def __init__(self, question: ProofQuestion, document: PermissionsDocument) -> None:
        self._question = question
        self._document = document
        self._eras = tuple(grant_periods(document, question.spec.subject_name, _SEMANTICS))
        grants = [era.grant for era in self._eras]
        self._pairs = permission_lists.has_partitions(question.lowered, grants)
        self._universe = Universe(
            octets.ALPHABET, fields=2 if self._pairs else 1, separator=permission_lists.SEPARATOR, last_nonempty=True
        )
        self._reason = ""
        self._known: dict[tuple[DecisionList, DecisionList], str | None] = {}

    def result(self) -> DocumentComparison:
        spec = self._question.spec
        unread, by_locale = octets.locale_dependence(
            self._document, [era.grant for era in self._eras], spec.rules, _SEMANTICS
        )
        if unread:
            return DocumentComparison(Relation.UNKNOWN, reason=unread)
        missing: tuple[str, _Place] | None = None
        excess: tuple[str, _Place] | None = None
        try:
            for place in self._places():
                policy, permitted = self._lists(place)
                missing = self._shorter(missing, place, policy, permitted)
                excess = self._shorter(excess, place, permitted, policy)
        except PatternError as error:
            return DocumentComparison(Relation.UNKNOWN, reason=f"{self._document.file}: {error}")
        lacks, exceeds = self._example(missing, permitted=False), self._example(excess, permitted=True)
        reason = self._reason or by_locale
        if reason and not (lacks and exceeds):
            return DocumentComparison(Relation.UNKNOWN, lacks, exceeds, reason)
        if lacks and exceeds:
            return DocumentComparison(Relation.DIFFERENT, lacks, exceeds)
        relation = Relation.NARROWER if lacks else Relation.WIDER if exceeds else Relation.EQUAL
        return DocumentComparison(relation, lacks, exceeds)

    def _places(self) -> Iterator[_Place]:
        """Yield every place where both may differ, one for each group of domains that are alike."""
        wanted = self._question.spec.domains
        rules = [rule for era in self._eras for rule in era.grant.rules]
        ranges = [DocumentDomains(each.first, each.last) for each in wanted]
        ranges += (domains for rule in rules for domains in rule.domains)
        seen = set()
        for domains in cuts(ranges):
            inside = any(each.first <= domains.first <= each.last for each in wanted)
            alike = (inside, *(_SEMANTICS.applies(rule, domains.first) for rule in rules))
            if alike not in seen:
                seen.add(alike)
                yield from self._in_domain(domains, inside=inside)

    def _in_domain(self, domains: DomainRange, *, inside: bool) -> Iterator[_Place]:
        for action in TopicAction:
            for era in self._eras or (None,):
                yield _Place(action, domains.first, inside, era)

    def _lists(self, place: _Place) -> tuple[DecisionList, DecisionList]:
        """Return what the rules allow, and what the document permits.

        Raises:
            PatternError: an expression of the document is not defined.
        """
        lowered, permitted = self._question.lowered, NOTHING
        policy = permission_lists.of_policy(lowered, place.action, pairs=self._pairs) if place.inside else NOTHING
        if place.era is not None:
            (permitted,) = permission_lists.of_grant(
                place.era.grant, place.domain, place.action, _SEMANTICS, pairs=self._pairs
            )
        return policy, permitted

    def _shorter(
        self, best: tuple[str, _Place] | None, place: _Place, more: DecisionList, less: DecisionList
    ) -> tuple[str, _Place] | None:
        """Return the shorter one of a name that was found before and one that only the first list permits here."""
        if (more, less) not in self._known:
            budget = SearchBudget(self._question.spec.states, self._question.spec.go_on)
            found = implies(more, less, self._universe, budget)
            self._known[more, less] = found.word if isinstance(found, Witness) else None
            if isinstance(found, Unknown):
                self._reason = found.reason
        word = self._known[more, less]
        return best if word is None or (best and len(best[0]) <= len(word)) else (word, place)

    def _example(self, found: tuple[str, _Place] | None, *, permitted: bool) -> Counterexample | None:
        """Return a name with the decisions of the plain evaluators, which must agree with what the engine found."""
        if found is None:
            return None
        word, place = found
        examples = Counterexamples(self._question, OMG, "", self._eras, self._pairs)
        example = examples.of(place.action, place.domain, place.era, word, inside=place.inside, permitted=permitted)
        if place.action == TopicAction.RELAY:  # the evaluator of policies knows no relay
            verb = "allow" if place.inside and not permitted else "do not allow"
            decision = PolicyDecision(allowed=not permitted, where=None, reason=Reason((f"the rules {verb} it",)))
            example = replace(example, policy=decision)
        if example.policy.allowed is permitted or example.document.allowed is not permitted:
            name = example.endpoint.name
            self._reason = f"the engine and the plain evaluators disagree on {name!r}: a defect of Keymint"
            return None
        return example
