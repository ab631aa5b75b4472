# SPDX-License-Identifier: Apache-2.0
"""Policy types: loaded policies, their rules, decisions, structure and tests."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from comarmor.errors import Origin, Reason
from comarmor.rules import Expectation
from comarmor.values import dataclass
from keymint.api.graph import Edge
from keymint.ir import Rule, SubjectRules

if TYPE_CHECKING:
    from comarmor.xml.package_folders import PackageFolders, ShippedFile


@dataclass(frozen=True, slots=True)
class PolicySource:
    """A policy that the profile names: a file or a directory."""

    name: str
    path: Path
    origin: Origin


@dataclass(frozen=True, slots=True)
class PolicyDecision:
    """A policy's decision on an edge.

    Attributes:
        allowed: the decision.
        where: the deciding rule; None if the edge is denied because no rule matches.
        reason: one line, in which the places of rules are data.
        audit: the deciding rule requires logging.
    """

    allowed: bool
    where: Origin | None
    reason: Reason
    audit: bool = False


@dataclass(frozen=True, slots=True)
class AppliedProfile:
    """A profile of a policy that applies to a subject: its label, its place, and whether it requires logging."""

    name: str
    where: Origin
    audit: bool = False


class LoadedPolicy(Protocol):
    """A policy that was loaded for a command."""

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that loading looked at, whether it exists or not, with its fingerprint.

        While :meth:`PolicyType.fingerprint` of all of them is unchanged, so is the policy.
        """

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""

    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject, outer ones first."""

    def decide(self, edge: Edge) -> PolicyDecision:
        """Decide an edge; its domain does not matter.

        Raises:
            KeymintError: the kind or the permission is not known.
        """


@runtime_checkable
class DivisiblePolicy(Protocol):
    """Optional capability of a loaded policy: it can be sent to another machine, a part at a time."""

    def about(self, subjects: Collection[str]) -> LoadedPolicy:
        """Return the policy about some subjects, as data that can be pickled; nothing is asked about others."""


@runtime_checkable
class RowPolicy(Protocol):
    """Optional capability of a loaded policy: decides about many objects at once."""

    def allowed(self, subject: str, kind: str, permission: str, names: Iterable[str]) -> bytes:
        """Decide about objects in the default partition, one byte each: 1 allowed, 0 denied.

        Args:
            subject: name of the subject.
            kind: kind of the objects.
            permission: a permission of that kind.
            names: names of the objects.

        Raises:
            KeymintError: the kind or the permission is not known.
        """


@runtime_checkable
class DigestedPolicy(Protocol):
    """Optional capability of a loaded policy: it knows which subjects have the rules that they had before."""

    def rules_digest(self, subject: str) -> str | None:
        """Return a digest that differs if the rules of a subject or their files do; None if no profile applies."""


@runtime_checkable
class PolicyWithPackages(Protocol):
    """Optional capability of a loaded policy: it knows which of its files packages ship."""

    @property
    def shipped(self) -> Sequence[ShippedFile]:
        """The files of packages that it was read from, each once."""


@dataclass(frozen=True, slots=True)
class WrittenProfile:
    """A profile as the policy writes it.

    Attributes:
        name: its label.
        where: where it is written.
        around: expressions of the enclosing profiles, outermost first; a subject must match one of each profile.
        attachments: its own expressions, each with its place.
    """

    name: str
    where: Origin
    around: tuple[tuple[str, ...], ...]
    attachments: tuple[tuple[str, Origin], ...]


@dataclass(frozen=True, slots=True)
class WrittenRule:
    """A rule as the policy writes it, before it is expanded for a subject.

    Attributes:
        profiles: expressions of its profiles, outermost first; a subject must match one of each profile.
        rule: the rule; its expressions may contain ``{name}`` and ``{namespace}``.
        expand: returns its expressions for given expressions of the namespace (ending with ``/``) and of the name.
        places: where each of its expressions is written; empty if unknown.
        included: the innermost profile includes it from another file.
    """

    profiles: tuple[tuple[str, ...], ...]
    rule: Rule
    expand: Callable[[str, str], tuple[str, ...]] = field(repr=False, compare=False)
    places: tuple[Origin, ...] = ()
    included: bool = False


@dataclass(frozen=True, slots=True)
class PolicyStructure:
    """The structure of a policy, independent of subjects.

    Attributes:
        profiles: its profiles, outer ones first.
        clauses: its rules, in the order of the policy.
        unused: name and place of each unused variable.
    """

    profiles: tuple[WrittenProfile, ...]
    clauses: Sequence[WrittenRule]
    unused: tuple[tuple[str, Origin], ...] = ()


@runtime_checkable
class StructuredPolicy(Protocol):
    """Optional capability of a loaded policy: its structure, for analyses of subjects that it does not name."""

    def structure(self) -> PolicyStructure | None:
        """Return the structure of the policy."""


@runtime_checkable
class PolicyTypeWithTests(Protocol):
    """Optional capability of a policy type: reads the test cases of a policy."""

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the test files of a policy, by file.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


@runtime_checkable
class PolicyTypeWithForm(Protocol):
    """Optional capability of a policy type: its files have a canonical form."""

    def written_files(self, folder: Path) -> Sequence[Path]:
        """Return, sorted, the files in a folder and below it that may be of this policy type; links are left out.

        Raises:
            KeymintError: a folder cannot be read.
        """

    def formatted(self, content: bytes, name: str) -> bytes | None:
        """Return a file in canonical form, which means the same; None if it is of another type.

        Args:
            content: the file.
            name: its path as the user would type it, for messages.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


@runtime_checkable
class RecognisedPolicy(Protocol):
    """Optional capability of a policy type whose files verbs meet where policies of another type are expected."""

    NOUN: str
    """What its files are called, with its article."""

    def recognises(self, path: Path) -> bool:
        """Tell whether a file is a policy of this type, valid or not; False if it cannot be read."""


class PolicyType(Protocol):
    """Loads policies of one format."""

    API: str

    def load(
        self, sources: Sequence[PolicySource], library: Path | None, library_shown: Path | None = None
    ) -> LoadedPolicy:
        """Load several policies as one: the union of their profiles.

        Args:
            sources: the policies.
            library: a folder that is searched for included files which a policy does not have.
            library_shown: path of the library in origins and in :attr:`LoadedPolicy.seen`, if it will be copied there.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def fingerprint(self, path: Path) -> bytes:
        """Return a digest of a path that changes when a policy loaded from it may change."""


@runtime_checkable
class PackageIncludes(Protocol):
    """Optional capability of a policy type: policies include files that ROS packages ship (docs/packages.md)."""

    def load_with_packages(
        self,
        sources: Sequence[PolicySource],
        library: Path | None,
        library_shown: Path | None,
        packages: PackageFolders,
    ) -> LoadedPolicy:
        """Load several policies as one: see :meth:`PolicyType.load`.

        Args:
            sources: the policies.
            library: as for :meth:`PolicyType.load`.
            library_shown: as for :meth:`PolicyType.load`.
            packages: finds the files that packages ship.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
