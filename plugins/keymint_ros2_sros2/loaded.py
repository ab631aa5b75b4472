# SPDX-License-Identifier: Apache-2.0
"""SROS2 policies as loaded policies, so that every verb that reads a policy can read them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from types import MappingProxyType

from comarmor.errors import ComArmorError, Origin
from comarmor.language.decide import RuleIndex
from comarmor.rules import Effect, Rule
from comarmor.values import dataclass
from keymint.api import (
    AppliedProfile,
    PolicyDecision,
    PolicySource,
    PolicyStructure,
    WrittenProfile,
    WrittenRule,
)
from keymint.errors import KeymintError
from keymint.graph import Edge
from keymint.ir import SubjectRules
from keymint_ros2_sros2.deviations import deviations
from keymint_ros2_sros2.parse import parse
from keymint_ros2_sros2.rules import rules_of
from keymint_ros2_sros2.syntax import Enclave


@dataclass(frozen=True, slots=True, eq=False)
class Sros2Policy:
    """A loaded SROS2 policy, as :class:`keymint.api.LoadedPolicy`.

    Attributes:
        seen: every path that loading looked at, with its fingerprint.
        places: where each enclave is written.
        rules_by_subject: the rules of each enclave.
    """

    seen: Mapping[Path, bytes]
    places: Mapping[str, Origin]
    rules_by_subject: Mapping[str, tuple[Rule, ...]]
    _indexes: dict[str, RuleIndex] = field(init=False, repr=False, default_factory=dict)

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the paths of the enclaves."""
        return tuple(sorted(self.rules_by_subject))

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of an enclave; None if the policy has no such enclave."""
        rules = self.rules_by_subject.get(subject)
        return None if rules is None else SubjectRules(subject, rules)

    def profiles(self, subject: str) -> tuple[AppliedProfile, ...]:
        """Return the enclave, which is to its path what a profile is to a subject."""
        where = self.places.get(subject)
        return () if where is None else (AppliedProfile(subject, where),)

    def decide(self, edge: Edge) -> PolicyDecision:
        """See :meth:`keymint.api.LoadedPolicy.decide`."""
        index = self._indexes.get(edge.subject)
        if index is None:
            index = self._indexes[edge.subject] = RuleIndex(self.rules_by_subject.get(edge.subject, ()))
        ruling = index.row(edge.object.kind, edge.permission).ruling(edge.object.name, edge.object.partitions)
        where = ruling.rules[0].origin if ruling.rules else None
        return PolicyDecision(ruling.effect is Effect.ALLOW, where, ruling.reason)

    def about(self, subjects: Collection[str]) -> Sros2Policy:
        """See :meth:`keymint.api.DivisiblePolicy.about`."""
        kept = {subject: self.rules_by_subject[subject] for subject in subjects if subject in self.rules_by_subject}
        return Sros2Policy({}, {subject: self.places[subject] for subject in kept}, kept)

    def allowed(self, subject: str, kind: str, permission: str, names: Iterable[str]) -> bytes:
        """See :meth:`keymint.api.RowPolicy.allowed`."""
        return RuleIndex(self.rules_by_subject.get(subject, ())).row(kind, permission).allowed(names)

    def structure(self) -> PolicyStructure:
        """Return the enclaves and their rules, which depend on no other subject."""
        profiles = (WrittenProfile(path, where, (), ((path, where),)) for path, where in self.places.items())
        clauses = (
            WrittenRule(((path,),), rule, _Constant(rule), (), bool(rule.origin.chain))
            for path, rules in self.rules_by_subject.items()
            for rule in rules
        )
        return PolicyStructure(tuple(profiles), tuple(clauses))


@dataclass(frozen=True, slots=True)
class _Constant:
    """The expressions of a rule, which are the same for every subject."""

    rule: Rule

    def __call__(self, namespace: str, name: str) -> tuple[str, ...]:
        """Return the expressions."""
        del namespace, name
        return self.rule.expressions


def load(
    sources: Sequence[PolicySource], library: Path | None = None, library_shown: Path | None = None
) -> Sros2Policy:
    """Load policies as one; see :meth:`keymint.api.PolicyType.load`.

    Raises:
        KeymintError: a policy is not valid, or SROS2 enforces something else than it reads; with ``file:line``.
    """
    del library, library_shown  # includes are in the policy's own folder
    seen: dict[Path, bytes] = {}
    enclaves: dict[str, Enclave] = {}
    rules: dict[str, tuple[Rule, ...]] = {}
    for source in sources:
        policy = parse(source.path)
        if found := [each.diagnostic for each in deviations(policy)]:
            raise KeymintError.of(found)
        seen |= policy.seen
        for enclave in policy.enclaves:
            if enclave.path in enclaves:
                raise ComArmorError(
                    f"the enclave {enclave.path} is also at {enclaves[enclave.path].where}", where=enclave.where,
                    help="write one <enclave>", code="sros2-path-twice",
                )  # fmt: skip
            enclaves[enclave.path] = enclave
            rules[enclave.path] = rules_of(policy, [enclave])
    places = {path: enclave.where for path, enclave in enclaves.items()}
    return Sros2Policy(MappingProxyType(seen), MappingProxyType(places), MappingProxyType(rules))
