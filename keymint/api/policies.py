"""Policies, loaded: rules, decisions, structure, and their own tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from comarmor.errors import Origin, Reason
from comarmor.rules import Expectation
from keymint.api.profiles import PolicySource
from keymint.graph import Edge
from keymint.ir import Rule, SubjectRules


@dataclass(frozen=True, slots=True)
class PolicyDecision:
    """What a policy says about an edge.

    Attributes:
        allowed: the decision.
        where: the rule that decided; None when no rule matches, which denies.
        reason: one line.
        audit: the rule that decided is to be watched.
    """

    allowed: bool
    where: Origin | None
    reason: Reason
    audit: bool = False


@dataclass(frozen=True, slots=True)
class AppliedProfile:
    """A profile of a policy that applies to a subject: its label, its place, and whether it is to be watched."""

    name: str
    where: Origin
    audit: bool = False


class LoadedPolicy(Protocol):
    """A policy, loaded once per command."""

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that was looked at, also those that were not there, with its fingerprint.

        As long as :meth:`PolicyType.fingerprint` gives the same for all of them, so is the policy.
        """

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""

    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject, outer ones first."""

    def decide(self, edge: Edge) -> PolicyDecision:
        """Return what the policy says about an edge; its domain is no matter of policy.

        Raises:
            KeymintError: the kind or the permission is not known.
        """


@dataclass(frozen=True, slots=True)
class WrittenProfile:
    """A profile as it is written.

    Attributes:
        name: its label.
        where: where it is written.
        around: expressions of the profiles around it, outermost first: a subject must match one of each.
        attachments: its own expressions, each with its place.
    """

    name: str
    where: Origin
    around: tuple[tuple[str, ...], ...]
    attachments: tuple[tuple[str, Origin], ...]


@dataclass(frozen=True, slots=True)
class WrittenRule:
    """A rule as it is written, before it is expanded for a subject.

    Attributes:
        profiles: expressions of the profiles that it stands in, outermost first: a subject must match one of each.
        rule: the rule; its expressions may hold ``{name}`` and ``{namespace}``.
        expand: returns its expressions for expressions of a namespace (with its last ``/``) and of a name.
        places: where each of its expressions is written; empty if that is not known.
        included: the innermost profile includes it from another file.
    """

    profiles: tuple[tuple[str, ...], ...]
    rule: Rule
    expand: Callable[[str, str], tuple[str, ...]] = field(repr=False, compare=False)
    places: tuple[Origin, ...] = ()
    included: bool = False


@dataclass(frozen=True, slots=True)
class PolicyStructure:
    """A policy as it is written.

    Attributes:
        profiles: its profiles, outer ones first.
        clauses: its rules, in the order of the policy.
        unused: name and place of the variables that nothing uses.
    """

    profiles: tuple[WrittenProfile, ...]
    clauses: tuple[WrittenRule, ...]
    unused: tuple[tuple[str, Origin], ...] = ()


@runtime_checkable
class StructuredPolicy(Protocol):
    """What a policy may offer beside :class:`LoadedPolicy`: itself as it is written, for subjects it does not name."""

    def structure(self) -> PolicyStructure | None:
        """Return the policy as it is written."""


@runtime_checkable
class PolicyTypeWithTests(Protocol):
    """What a policy type may offer beside :class:`PolicyType`: reading of a policy's own unit tests."""

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the test files beside a policy, by file.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


class PolicyType(Protocol):
    """Acquires policy: sources to IR."""

    API: str

    def load(
        self, sources: Sequence[PolicySource], library: Path | None, library_shown: Path | None = None
    ) -> LoadedPolicy:
        """Load policies as one: the union of their profiles.

        Args:
            sources: the policies.
            library: a folder in which includes are looked up that a policy itself does not have.
            library_shown: path of the library in origins and in :attr:`LoadedPolicy.seen`, if it will be copied there.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def fingerprint(self, path: Path) -> bytes:
        """Return what tells whether a path is still what it was when a policy was loaded from it."""
