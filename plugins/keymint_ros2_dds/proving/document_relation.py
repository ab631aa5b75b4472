# SPDX-License-Identifier: Apache-2.0
"""Compare a permissions document with rules in both directions: what it lacks, and what it permits beyond them.

The standard's reading decides (DDS Security 1.1, 9.4.1.3). Relay is compared as well. The governance is not: all
topics count as under access control.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

from comarmor.patterns.decision_lists import DecisionList, Unknown, Witness
from comarmor.patterns.proofs import escapes
from comarmor.patterns.tokens import PatternError
from keymint.api import ComparisonTask, Counterexample, DocumentComparison, Relation
from keymint.errors import KeymintError
from keymint_ros2_dds.decision.semantics import OMG
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS
from keymint_ros2_dds.proving import document_lists, octets
from keymint_ros2_dds.proving.document_lists import NOTHING
from keymint_ros2_dds.proving.grant_periods import grant_periods
from keymint_ros2_dds.proving.questions import Counterexamples, ProofQuestion, Situation
from keymint_ros2_dds.reading.signed_permissions import read

_SEMANTICS = OMG.semantics


def compare_document(task: ComparisonTask) -> DocumentComparison:
    """Compare a document with rules; see :meth:`keymint.api.KeystoreReader.compared`.

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
    return _Comparison(ProofQuestion(document, task, lowered)).result()


_Found = tuple[str, Situation]
"""A name on which both differ, in the words of the engine, and when."""


class _Comparison:
    """Compares a document with the rules of a question."""

    def __init__(self, question: ProofQuestion) -> None:
        self._question = question
        self._eras = tuple(grant_periods(question.document, question.task.subject_name, _SEMANTICS))
        grants = [era.grant for era in self._eras]
        self._pairs = document_lists.has_partitions(question.lowered, grants)
        self._universe = octets.universe(pairs=self._pairs)
        self._reason = ""
        self._known: dict[tuple[DecisionList, DecisionList], Sequence[str]] = {}

    def result(self) -> DocumentComparison:
        question, grants = self._question, [era.grant for era in self._eras]
        unread, by_locale = octets.locale_dependence(question.document, grants, question.task.rules, _SEMANTICS)
        if unread:
            return DocumentComparison(Relation.UNKNOWN, reason=unread)
        missing, excess = list[_Found](), list[_Found]()
        try:
            for situation in self._situations():
                action, era, pairs = situation.action, situation.era, self._pairs
                policy, permitted = NOTHING, NOTHING
                if situation.inside:
                    policy = document_lists.of_policy(question.lowered, action, pairs=pairs)
                if era is not None:
                    domain = situation.domain
                    (permitted,) = document_lists.of_grant(era.grant, domain, action, _SEMANTICS, pairs=pairs)
                missing += ((word, situation) for word in self._only(policy, permitted))
                excess += ((word, situation) for word in self._only(permitted, policy))
        except PatternError as error:
            return DocumentComparison(Relation.UNKNOWN, reason=f"{question.document.file}: {error}")
        lacks, exceeds = self._example(missing, permitted=False), self._example(excess, permitted=True)
        reason = self._reason or by_locale
        if reason and not (lacks and exceeds):
            return DocumentComparison(Relation.UNKNOWN, lacks, exceeds, reason)
        if lacks and exceeds:
            return DocumentComparison(Relation.DIFFERENT, lacks, exceeds)
        relation = Relation.NARROWER if lacks else Relation.WIDER if exceeds else Relation.EQUAL
        return DocumentComparison(relation, lacks, exceeds)

    def _situations(self) -> Iterator[Situation]:
        """Yield every situation in which both may differ, one for each group of domains that are alike."""
        rules = [rule for era in self._eras for rule in era.grant.rules]
        seen = set()
        for domains, inside, applying in self._question.domains(rules, _SEMANTICS):
            if (inside, applying) not in seen:
                seen.add((inside, applying))
                for action, era in product(TOPIC_ACTIONS, self._eras or (None,)):
                    yield Situation(action, domains.first, inside, era)

    def _only(self, more: DecisionList, less: DecisionList) -> Sequence[str]:
        """Return a shortest name that only the first list permits; nothing if there is none, or it is not known."""
        if (more, less) not in self._known:
            found = escapes([more], less, self._universe, self._question.budget())
            self._known[more, less] = [found.word] if isinstance(found, Witness) else []
            if isinstance(found, Unknown):
                self._reason = found.reason
        return self._known[more, less]

    def _example(self, found: Sequence[_Found], *, permitted: bool) -> Counterexample | None:
        """Return a shortest name with the decisions of the plain evaluators."""
        if not found:
            return None
        word, situation = min(found, key=lambda each: len(each[0]))
        examples = Counterexamples(self._question, OMG, "", self._eras, self._pairs)
        example, defect = examples.of(situation, word, permitted=permitted)
        self._reason = defect or self._reason
        return None if defect else example
