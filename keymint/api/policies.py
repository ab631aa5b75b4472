# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - defaults ignore their arguments
"""Policies: what loaded ones decide, and their types, which load, format, import, export and learn them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from comarmor.rules import Expectation
from comarmor.values import Data, field
from keymint.errors import Diagnostic, Origin, Reason
from keymint.ir import Rule, SubjectRules

if TYPE_CHECKING:
    from comarmor.xml.package_folders import PackageFolders, ShippedFile
    from keymint.api.exchange import ExportedPolicy, ImportedPolicy, ImportRequest, LearnedPolicy
    from keymint.api.graph import Edge, Graph


class PolicySource(Data):
    """A policy that the profile names: a file or a directory."""

    name: str
    path: Path
    origin: Origin


class PolicyDecision(Data):
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


class AppliedProfile(Data):
    """A profile of a policy that applies to a subject: its label, its place, and whether it requires logging."""

    name: str
    where: Origin
    audit: bool = False


class WrittenProfile(Data):
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


class WrittenRule(Data):
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


class PolicyStructure(Data):
    """The structure of a policy, independent of subjects.

    Attributes:
        profiles: its profiles, outer ones first.
        clauses: its rules, in the order of the policy.
        unused: name and place of each unused variable.
    """

    profiles: tuple[WrittenProfile, ...]
    clauses: Sequence[WrittenRule]
    unused: tuple[tuple[str, Origin], ...] = ()


class LoadedPolicy(ABC):
    """A policy that was loaded for a command. What has a default is optional."""

    @property
    @abstractmethod
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that loading looked at, whether it exists or not, with its fingerprint.

        While :meth:`PolicyType.fingerprint` of all of them is unchanged, so is the policy.
        """

    @abstractmethod
    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""

    @abstractmethod
    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""

    @abstractmethod
    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject, outer ones first."""

    @abstractmethod
    def decide(self, edge: Edge) -> PolicyDecision:
        """Decide an edge; its domain does not matter.

        Raises:
            KeymintError: the kind or the permission is not known.
        """

    def allowed(self, subject: str, kind: str, permission: str, names: Iterable[str]) -> bytes:
        """Decide about many objects in the default partition, one byte each: 1 allowed, 0 denied.

        Args:
            subject: name of the subject.
            kind: kind of the objects.
            permission: a permission of that kind.
            names: names of the objects.

        Raises:
            KeymintError: the kind or the permission is not known.
        """
        graph = import_module("keymint.api.graph")  # most policies have a quicker way
        return bytes(self.decide(graph.Edge(subject, permission, graph.Object(kind, name))).allowed for name in names)

    def root_profiles(self) -> tuple[str, ...]:
        """Return the labels of the profiles that no other one encloses; none if it does not know its profiles."""
        structure = self.structure()
        return tuple(each.name for each in structure.profiles if not each.around) if structure else ()

    def rules_digest(self, subject: str) -> str | None:
        """Return a digest that differs if the rules of a subject or their files do.

        None if no profile applies, or it does not know which subjects have the rules that they had before.
        """
        return None

    @property
    def shipped(self) -> Sequence[ShippedFile] | None:
        """The files of ROS packages that it was read from, each once; None if it does not know them."""
        return None

    @property
    def findings(self) -> Sequence[Diagnostic]:
        """Likely mistakes that only the format of the policy shows, as warnings."""
        return ()

    def structure(self) -> PolicyStructure | None:
        """Return the structure of the policy, for analyses of subjects that it does not name; None if it has none."""
        return None


# -- types of policies ------------------------------------------------------------------------------------------------


class PolicyType(ABC):
    """Loads policies of one format. What has a default is optional."""

    API: str
    NOUN: str = ""
    """What its files are called, with its article, where verbs meet them among policies of another type."""
    TOOL: str = ""
    """The tool that the policies are written for; empty if they need no import, and :meth:`translated` is not asked."""
    BUILD_TYPE: str = ""
    """The build type that reads what this tool writes."""
    FORMAT: str = ""
    """The name of the format that :meth:`exported` writes; empty if it writes none."""

    @abstractmethod
    def load(
        self,
        sources: Sequence[PolicySource],
        library: Path | None,
        library_shown: Path | None = None,
        packages: PackageFolders | None = None,
    ) -> LoadedPolicy:
        """Load several policies as one: the union of their profiles.

        Args:
            sources: the policies.
            library: a folder that is searched for included files which a policy does not have.
            library_shown: path of the library in origins and in :attr:`LoadedPolicy.seen`, if it will be copied there.
            packages: finds the files that ROS packages ship (docs/packages.md), if policies can include them; without
                it none is found.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    @abstractmethod
    def fingerprint(self, path: Path) -> bytes:
        """Return a digest of a path that changes when a policy loaded from it may change."""

    def recognises(self, path: Path) -> bool:
        """Tell whether a file is a policy of this type, valid or not; False if it cannot be read."""
        return False

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]] | None:
        """Return the expectations in the test files of a policy, by file; None if it has no tests.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return None

    def written_files(self, folder: Path) -> Sequence[Path]:
        """Return, sorted, the files in a folder and below it that may be of this policy type; links are left out.

        Raises:
            KeymintError: a folder cannot be read.
        """
        return ()

    def formatted(self, content: bytes, name: str) -> bytes | None:
        """Return a file in canonical form, which means the same; None if it is of another type.

        Args:
            content: the file.
            name: its path as the user would type it, for messages.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return None

    def translated(self, request: ImportRequest) -> ImportedPolicy:
        """Translate a policy to the language of Keymint.

        Raises:
            KeymintError: the policy is not valid, cannot be expressed, or is not enforced as it reads and that is not
                accepted; every defect with its ``file:line``.
        """
        raise NotImplementedError

    def exported(self, subjects: Sequence[SubjectRules], *, lossy: bool = False) -> ExportedPolicy:
        """Write rules in this format.

        Args:
            subjects: the rules of each subject.
            lossy: leave out what the format cannot express, where it only allows something.

        Raises:
            KeymintError: a rule cannot be expressed; each with its ``file:line``.
        """
        raise NotImplementedError

    def policy_of(
        self, subjects: Sequence[SubjectRules], name: str, note: str = ""
    ) -> tuple[bytes, tuple[SubjectRules, ...]] | None:
        """Write a policy in which each subject has its rules, and read it again.

        Args:
            subjects: rules of kinds and permissions that policies have; of several of one kind, the fewest are written.
            name: path of the new policy, as the user would type it, for the places of its rules.
            note: a comment for its head; empty for none.

        Returns:
            The document, and the rules of each subject as it gives them. None if this type writes no rules.

        Raises:
            KeymintError: the format cannot express a rule.
        """
        return None

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy | None:
        """Return the smallest policy that, with the existing one, allows every edge of a graph; None if it cannot.

        Args:
            graph: the observed edges.
            existing: a policy of the same type that remains in force.
            fragments: folder, relative to the policy, for included files; empty for a single document.

        Raises:
            KeymintError: the policy format cannot express an edge.
        """
        return None
