# SPDX-License-Identifier: Apache-2.0
"""What is to be proven about a permissions document."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from datetime import datetime

from comarmor.patterns.decision_lists import SearchBudget
from comarmor.values import dataclass
from keymint.api import ComparisonTask, DomainRange
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.lowering.lowered_rules import Lowered
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance, cuts
from keymint_ros2_dds.reading.signed_permissions import DocumentRule, PermissionsDocument


@dataclass(frozen=True, slots=True)
class ProofQuestion:
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
