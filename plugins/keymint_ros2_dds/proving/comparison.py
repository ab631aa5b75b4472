# SPDX-License-Identifier: Apache-2.0
"""Compare the policy with what permissions and governance permit, over all names."""

from __future__ import annotations

from comarmor.patterns.decision_lists import DecisionList, ProofResult, Witness
from comarmor.patterns.proofs import escapes
from keymint_ros2_dds.proving import octets, permission_lists
from keymint_ros2_dds.proving.counterexamples import Situation
from keymint_ros2_dds.proving.enclave_governance import ACTIONS
from keymint_ros2_dds.proving.governance_lists import NOTHING, Permitted, difference
from keymint_ros2_dds.proving.questions import ProofQuestion


class Comparator:
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
        self._universe = octets.universe(pairs=self.pairs)
        self.lists = permission_lists.GrantLists(question.document.grants, pairs=self.pairs)
        self.independent = octets.is_independent(question.document, question.task.rules)
        self._policy = {
            action: permission_lists.of_policy(question.lowered, action, pairs=self.pairs) for action in ACTIONS
        }
        self._known: dict[tuple[object, ...], ProofResult] = {}

    def of(self, situation: Situation, permitted: Permitted) -> ProofResult:
        """Compare what the policy allows with what the document permits."""
        policy = self._policy[situation.action] if situation.inside else NOTHING
        key = (policy, permitted)
        result = self._known.get(key)
        if result is None:
            result = self._known[key] = self._compared(policy, permitted)
        return result

    def _compared(self, policy: DecisionList, permitted: Permitted) -> ProofResult:
        budget = self._question.budget()
        if self._question.since is None:
            return difference(policy, permitted, self._universe, budget)
        found = escapes(permitted.lists, policy, self._universe, budget)
        return Witness(found.word, left=False) if isinstance(found, Witness) else found
