# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_comarmor``: loads ComArmor policies, and learns them from graphs."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import comarmor
import comarmor.language.source
from comarmor.language.decide import Ruling
from comarmor.rules import Effect, Expectation
from comarmor.values import dataclass
from comarmor.xml.package_folders import PackageFolders, ShippedFile
from keymint.api import (
    API_VERSION,
    AppliedProfile,
    LearnedPolicy,
    LoadedPolicy,
    PolicyDecision,
    PolicyOfRules,
    PolicySource,
    PolicyStructure,
)
from keymint.errors import KeymintError
from keymint.graph import Edge, Graph
from keymint.ir import SubjectRules

__all__ = ["ComArmorPolicyType", "policy_type"]


@dataclass(frozen=True, slots=True)
class ComArmorPolicy:
    """A loaded ComArmor policy, as :class:`keymint.api.LoadedPolicy`."""

    policy: comarmor.Policy

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that loading looked at, with its fingerprint."""
        return self.policy.seen

    @property
    def shipped(self) -> tuple[ShippedFile, ...]:
        """See :attr:`keymint.api.PolicyWithPackages.shipped`."""
        return self.policy.shipped

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""
        return self.policy.subjects()

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""
        if not self.policy.applicable(subject):
            return None
        return SubjectRules(subject, self.policy.rules(subject))

    def rules_digest(self, subject: str) -> str | None:
        """See :meth:`keymint.api.DigestedPolicy.rules_digest`."""
        return self.policy.rules_digest(subject)

    def profiles(self, subject: str) -> tuple[AppliedProfile, ...]:
        """Return the profiles that apply to a subject, outer ones first."""
        return tuple(
            AppliedProfile(profile.name, profile.where, profile.audit) for profile in self.policy.applicable(subject)
        )

    def structure(self) -> PolicyStructure:
        """Return the structure of the policy."""
        from keymint_ros2_comarmor.structure import structure  # noqa: PLC0415 - few verbs need it

        return structure(self.policy)

    def decide(self, edge: Edge) -> PolicyDecision:
        """See :meth:`keymint.api.LoadedPolicy.decide`."""
        requested = edge.object
        row = self.policy.row(edge.subject, requested.kind, edge.permission)
        return _decision(row.ruling(requested.name, requested.partitions))

    def about(self, subjects: Collection[str]) -> ComArmorPolicy:
        """See :meth:`keymint.api.DivisiblePolicy.about`."""
        applicable = {id(profile) for subject in subjects for profile in self.policy.applicable(subject)}
        return ComArmorPolicy(comarmor.Policy(tuple(each for each in self.policy.profiles if id(each) in applicable)))

    def allowed(self, subject: str, kind: str, permission: str, names: Iterable[str]) -> bytes:
        """See :meth:`keymint.api.RowPolicy.allowed`."""
        return self.policy.row(subject, kind, permission).allowed(names)


@functools.lru_cache(maxsize=1024)
def _decision(ruling: Ruling) -> PolicyDecision:
    """Return the decision of a ruling, which most requests share with others."""
    where = ruling.rules[0].origin if ruling.rules else None
    audit = any(rule.audit for rule in ruling.rules)
    return PolicyDecision(ruling.effect is Effect.ALLOW, where, ruling.reason, audit)


class ComArmorPolicyType:
    """Loads policies in the ComArmor language."""

    API = API_VERSION

    def load(
        self, sources: Sequence[PolicySource], library: Path | None, library_shown: Path | None = None
    ) -> ComArmorPolicy:
        """See :meth:`keymint.api.PolicyType.load`."""
        return self._loaded(sources, library, library_shown, None)

    def load_with_packages(
        self,
        sources: Sequence[PolicySource],
        library: Path | None,
        library_shown: Path | None,
        packages: PackageFolders,
    ) -> ComArmorPolicy:
        """See :meth:`keymint.api.PackageIncludes.load_with_packages`."""
        return self._loaded(sources, library, library_shown, packages)

    def _loaded(
        self,
        sources: Sequence[PolicySource],
        library: Path | None,
        library_shown: Path | None,
        packages: PackageFolders | None,
    ) -> ComArmorPolicy:
        for source in sources:
            if not source.path.exists():
                raise KeymintError(
                    f"the policy '{source.path}' does not exist",
                    where=source.origin,
                    help="name a ComArmor file, or a directory of *.xml files",
                    code="policy-missing",
                )
        paths = [source.path for source in sources]
        loaded = comarmor.load_all(paths, library=library, library_shown=library_shown, packages=packages)
        return ComArmorPolicy(loaded)

    def fingerprint(self, path: Path) -> bytes:
        """Return a digest of a path that changes when a policy loaded from it may change."""
        return comarmor.language.source.fingerprint(path)

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the ``*.test.xml`` files beside a policy, or in one such file."""
        from comarmor.language.policy_tests import expectations  # noqa: PLC0415 - only one verb needs it

        return expectations(path)

    def written_files(self, folder: Path) -> Sequence[Path]:
        """See :meth:`keymint.api.PolicyTypeWithForm.written_files`."""
        from comarmor.language.formatting import written_files  # noqa: PLC0415 - only one verb needs it

        return written_files(folder)

    def formatted(self, content: bytes, name: str) -> bytes | None:
        """See :meth:`keymint.api.PolicyTypeWithForm.formatted`."""
        from comarmor.language.formatting import formatted  # noqa: PLC0415 - only one verb needs it

        return formatted(content, name)

    def policy_of(self, subjects: Sequence[SubjectRules], name: str, note: str = "") -> PolicyOfRules:
        """See :func:`keymint_ros2_comarmor.policy_of_rules.policy_of`.

        Raises:
            KeymintError: an expression or the name of a subject cannot be written.
        """
        from keymint_ros2_comarmor.policy_of_rules import policy_of  # noqa: PLC0415 - few verbs need it

        return policy_of(subjects, name, note)

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
        """See :func:`keymint_ros2_comarmor.learn.learn`.

        Raises:
            KeymintError: the existing policy is not of this type.
        """
        from keymint_ros2_comarmor.learn import learn  # noqa: PLC0415 - only this verb needs it

        if existing is not None and not isinstance(existing, ComArmorPolicy):
            raise KeymintError("the existing policy is not a ComArmor policy", code="policy-type")
        return learn(graph, existing.policy if existing else None, fragments)


policy_type = ComArmorPolicyType()
