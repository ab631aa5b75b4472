"""Policy type ``keymint_ros2_comarmor``: ComArmor policies to the intermediate representation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import comarmor
import comarmor.language.source
from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.rules import Effect
from keymint.api import AppliedProfile, Expectation, Learned, LoadedPolicy, PolicyDecision, PolicySource, Structure
from keymint.errors import KeymintError
from keymint.graph import Edge, Graph
from keymint.ir import Rule, SubjectRules

__all__ = ["ComArmorPolicyType", "policy_type"]


def _origin(where: comarmor.Origin) -> Origin:
    return Origin(where.file, where.line, tuple(_origin(outer) for outer in where.chain), where.column)


def _diagnostic(found: comarmor.Diagnostic) -> Diagnostic:
    where = _origin(found.where) if found.where else None
    return Diagnostic(found.code, Severity(found.severity.value), found.message, where, found.help)


def _rule(rule: comarmor.Rule) -> Rule:
    return Rule(
        effect=Effect(rule.effect.value),
        kind=rule.kind,
        permissions=rule.permissions,
        expressions=tuple(dict.fromkeys(attachment.text for attachment in rule.attachments)),
        partitions=rule.partitions,
        audit=rule.audit,
        origin=_origin(rule.where),
    )


@dataclass(frozen=True, slots=True)
class _LoadedPolicy:
    """A ComArmor policy, loaded once per command."""

    policy: comarmor.Policy
    _known: dict[int, tuple[comarmor.Rule, Rule]] = field(default_factory=dict, repr=False, compare=False)

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that was looked at, with its fingerprint."""
        return self.policy.seen

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""
        return self.policy.subjects()

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""
        if not self.policy.applicable(subject):
            return None
        return SubjectRules(subject, tuple(map(self._shared, self.policy.rules(subject))))

    def _shared(self, rule: comarmor.Rule) -> Rule:
        """Return a rule; the same one for all subjects, where it does not depend on the subject."""
        known = self._known.get(id(rule))
        if known is not None and known[0] is rule:
            return known[1]
        found = _rule(rule)
        if not any(attachment.value for attachment in rule.attachments):
            self._known[id(rule)] = (rule, found)
        return found

    def profiles(self, subject: str) -> tuple[AppliedProfile, ...]:
        """Return the profiles that apply to a subject, outer ones first."""
        return tuple(
            AppliedProfile(profile.name, _origin(profile.where), profile.audit)
            for profile in self.policy.applicable(subject)
        )

    def structure(self) -> Structure:
        """Return the policy as it is written."""
        from keymint_ros2_comarmor.structure import structure  # noqa: PLC0415 - few verbs need it

        return structure(self.policy, _origin, _rule)

    def decide(self, edge: Edge) -> PolicyDecision:
        """Return what the policy says about an edge; errors as :meth:`keymint.api.LoadedPolicy.decide`."""
        found = edge.object
        try:
            decision = self.policy.decide(edge.subject, found.kind, edge.permission, found.name, found.partitions)
        except comarmor.ComArmorError as error:
            raise KeymintError.of(map(_diagnostic, error.diagnostics)) from error
        where = _origin(decision.where) if decision.where else None
        reason = decision.reason
        for rule in decision.rules:  # a place in the library is cited by its name there
            reason = reason.replace(str(rule.where), str(_origin(rule.where)))
        return PolicyDecision(decision.allowed, where, reason, decision.audit)


class ComArmorPolicyType:
    """Acquires policy in the ComArmor profile language."""

    API = "1.0"

    def load(self, sources: Sequence[PolicySource], library: Path | None) -> _LoadedPolicy:
        """Load policies as one: the union of their profiles.

        Args:
            sources: files or directories; includes of each are confined to its own folder.
            library: a folder in which includes are looked up that a policy itself does not have.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        for source in sources:
            if not source.path.exists():
                raise KeymintError(
                    f"the policy '{source.path}' does not exist",
                    where=source.origin,
                    help="name a ComArmor file, or a directory of *.xml files",
                    code="policy-missing",
                )
        try:
            return _LoadedPolicy(comarmor.load_all([source.path for source in sources], library=library))
        except comarmor.ComArmorError as error:
            raise KeymintError.of(map(_diagnostic, error.diagnostics)) from error

    def fingerprint(self, path: Path) -> bytes:
        """Return what tells whether a path is still what it was when a policy was loaded."""
        return comarmor.language.source.fingerprint(path)

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the ``*.test.xml`` files beside a policy, or in one such file.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        from comarmor.language.policy_tests import expectations  # noqa: PLC0415 - only one verb needs it

        try:
            found = expectations(path)
        except comarmor.ComArmorError as error:
            raise KeymintError.of(map(_diagnostic, error.diagnostics)) from error
        return {
            file: tuple(
                Expectation(
                    one.test, one.allowed, one.subject, one.permission, one.object, one.partition, _origin(one.where)
                )
                for one in listed
            )
            for file, listed in found.items()
        }

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> Learned:
        """See :func:`keymint_ros2_comarmor.learn.learn`.

        Raises:
            KeymintError: the existing policy is not one of this type.
        """
        from keymint_ros2_comarmor.learn import learn  # noqa: PLC0415 - only this verb needs it

        if existing is not None and not isinstance(existing, _LoadedPolicy):
            raise KeymintError("the existing policy is not a ComArmor policy", code="policy-type")
        return learn(graph, existing.policy if existing else None, fragments)


policy_type = ComArmorPolicyType()
