# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - defaults ignore their arguments
"""Loaded policies: their rules, decisions and structure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING

from comarmor.errors import Origin, Reason
from comarmor.values import dataclass
from keymint.api.graph import Edge, Object
from keymint.ir import Rule, SubjectRules

if TYPE_CHECKING:
    from comarmor.xml.package_folders import ShippedFile


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
        return bytes(self.decide(Edge(subject, permission, Object(kind, name))).allowed for name in names)

    def about(self, subjects: Collection[str]) -> LoadedPolicy | None:
        """Return the policy about some subjects, as data that can be pickled; nothing is asked about others.

        None if it cannot be sent to another machine.
        """
        return None

    def rules_digest(self, subject: str) -> str | None:
        """Return a digest that differs if the rules of a subject or their files do.

        None if no profile applies, or it does not know which subjects have the rules that they had before.
        """
        return None

    @property
    def shipped(self) -> Sequence[ShippedFile] | None:
        """The files of ROS packages that it was read from, each once; None if it does not know them."""
        return None

    def structure(self) -> PolicyStructure | None:
        """Return the structure of the policy, for analyses of subjects that it does not name; None if it has none."""
        return None
