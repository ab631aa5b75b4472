# SPDX-License-Identifier: Apache-2.0
"""What a build type can do beside building: optional capabilities, which are found by their methods."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from comarmor.errors import Diagnostic
from keymint.api.building import (
    Artifact,
    BuildOptions,
    EnvironmentVariable,
)
from keymint.api.graph import Edge
from keymint.api.packages import Package
from keymint.api.transports import Enclave
from keymint.ir import SubjectRules


@runtime_checkable
class CommonNameIdentity(Protocol):
    """Optional capability of a build type: its transport knows a subject by a common name alone.

    Then the common name has the generation (:attr:`Issuance.generation`), so that a revoked identity loses its rights.
    """

    KNOWS_COMMON_NAMES_ONLY: bool


@runtime_checkable
class RevocationReader(Protocol):
    """Optional capability of a build type: its transport reads revocation lists."""

    def revocation_files(self, distro: str, layout: str, revocations: bytes) -> Mapping[str, Artifact]:
        """Return the files with which an enclave has a revocation list, by name; empty if the transport reads none.

        Args:
            distro: the ROS 2 distribution.
            layout: name of the layout.
            revocations: the list, PEM.
        """


@runtime_checkable
class ProcessEnvironment(Protocol):
    """Optional capability of a build type: processes find the keystore by environment variables."""

    def keystore_variables(self, distro: str, layout: str) -> Sequence[EnvironmentVariable]:
        """Return the variables that all processes of a robot have.

        Args:
            distro: the ROS 2 distribution.
            layout: name of the layout.
        """

    def enclave_variables(
        self, distro: str, layout: str, subject: str, files: Collection[str]
    ) -> Sequence[EnvironmentVariable]:
        """Return the variables of one process that uses an enclave, those of all processes that it needs included.

        Args:
            distro: the ROS 2 distribution.
            layout: name of the layout.
            subject: the subject of the enclave, e.g. ``/robot1/talker``.
            files: the names of the enclave's files.
        """


@runtime_checkable
class VendorModels(Protocol):
    """Optional capability of a build type: claims are made for the versions of vendors that a distribution ships."""

    def models(self, distro: str = "") -> Mapping[str, str]:
        """Return how each model that claims are made for is known: specified, measured, or from sources.

        A simulated transport may have the name of a model.

        Args:
            distro: the ROS 2 distribution; empty for all models.
        """


@runtime_checkable
class VendorAdvisories(Protocol):
    """Optional capability of a build type: known vulnerabilities of the software that reads its files."""

    VENDORS: tuple[str, ...]
    """Names of the vendors that advisories are known for."""

    def installed_vendors(self, environment: Mapping[str, str]) -> Mapping[str, Sequence[str]]:
        """Return the versions of each vendor that are installed on this machine; none that is not found.

        Args:
            environment: variables, of which some name folders of installed software.
        """

    def advisories(self, vendor: str, version: str) -> Sequence[Diagnostic]:
        """Return a finding for each known vulnerability of access control that affects a version of a vendor."""


@runtime_checkable
class RemoteCompiler(Protocol):
    """Optional capability of a build type: other machines, which nobody vouches for, may compile for it."""

    def is_remote(self, package: Package) -> bool:
        """Tell whether another machine may compile a package: what it answers can be proven."""

    def compiling(self) -> Callable[[Any, Sequence[tuple[Package, BuildOptions]]], Sequence[object]]:
        """Return the function of a module that a worker calls with packages; its annotation has the exact type.

        Its result has an item for each package; None if there is more to say about the package than its documents.
        """

    def receive(self, package: Package, options: BuildOptions, compilation: object, *, trusted: bool) -> None:
        """Keep such an item for :meth:`BuildType.build`, which proves it before it uses it, unless it is trusted."""


@runtime_checkable
class RuleCheck(Protocol):
    """Optional capability of a build type: examines the rules of a subject alone, without a package."""

    def check_rules(self, rules: SubjectRules, distro: str) -> Sequence[Diagnostic]:
        """Return the rules that it cannot express, that implementations read differently, or that have no effect.

        Args:
            rules: the policy's rules for a subject.
            distro: ROS 2 distribution whose name mapping applies.

        Returns:
            Findings at the place of a rule, with stable codes; their severity is that of a build.
        """


@runtime_checkable
class NodeCheck(Protocol):
    """Optional capability of a build type: its transport refuses what a node creates, and so keeps it from starting."""

    def check_node(self, rules: SubjectRules, distro: str) -> Iterable[Diagnostic]:
        """Return notes on what cannot start with default options, each with a stable code and the subject.

        Args:
            rules: the rules of a subject.
            distro: ROS 2 distribution of its nodes.
        """


@runtime_checkable
class InstalledNames(Protocol):
    """Optional capability of a build type with shared documents: tells which names to ask transports about."""

    def installed_names(self, enclave: Enclave) -> Sequence[str]:
        """Return expressions of application names like those in the shared documents; none if these cannot be read."""


@runtime_checkable
class NameMapping(Protocol):
    """Optional capability of a build type: maps edges on application names to endpoints of the transport.

    Rules on application names and rules on transport names both apply to an endpoint.
    """

    def endpoints(self, distro: str, edge: Edge) -> Sequence[Edge]:
        """Return the edges of kind ``topic`` that implement an edge; an edge of that kind implements itself.

        Raises:
            KeymintError: the distribution or the permission is not known.
        """

    def meanings(self, distro: str, endpoint: Edge) -> Sequence[Edge]:
        """Return the elementary edges of other kinds that this edge of kind ``topic`` implements."""

    def document_topics(self, enclave: Enclave) -> Sequence[tuple[str, Sequence[str]]]:
        """Return the topic expressions in the signed documents of an enclave, each with its partitions."""
