# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - defaults ignore their arguments
"""Build types: build unsigned documents of a package, sign and install them, check and prove installed enclaves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from keymint.api.building import (
    Artifact,
    AuthorityRole,
    BuildOptions,
    BuildResult,
    Credentials,
    EnvironmentVariable,
    Implementation,
    Inspection,
    Layout,
)
from keymint.api.packages import Package, PackageSettings, PackageSources
from keymint.api.profiles import WorkspaceProfile
from keymint.api.proving import Claim, Prover, SharedProofTask
from keymint.errors import Diagnostic
from keymint.ir import SubjectRules

if TYPE_CHECKING:
    from keymint.api.foreign_keystores import KeystoreReader
    from keymint.api.graph import Edge
    from keymint.api.rights import DocumentComparison, ExcessRights, PresentationTask
    from keymint.api.transports import Endpoint, InstalledEnclave


class NameMapping(ABC):
    """Maps edges on application names to endpoints of a transport.

    Rules on application names and rules on transport names both apply to an endpoint.
    """

    @abstractmethod
    def endpoints(self, distro: str, edge: Edge) -> Sequence[Edge]:
        """Return the edges of kind ``topic`` that implement an edge; an edge of that kind implements itself.

        Raises:
            KeymintError: the distribution or the permission is not known.
        """

    @abstractmethod
    def meanings(self, distro: str, endpoint: Edge) -> Sequence[Edge]:
        """Return the elementary edges of other kinds that this edge of kind ``topic`` implements."""

    @abstractmethod
    def document_topics(self, enclave: InstalledEnclave) -> Sequence[tuple[str, Sequence[str]]]:
        """Return the topic expressions in the signed documents of an enclave, each with its partitions."""


class Presentation(ABC):
    """What is known about signed documents that the enclaves of a build type present to each other."""

    FILE: str
    """Name of the file of an enclave that they present."""

    @abstractmethod
    def presented_until(self, content: bytes) -> datetime | None:
        """Return the end of the rights that a signed document grants, UTC; None if it grants none to anybody.

        Args:
            content: what is signed.
        """

    @abstractmethod
    def choosers(self) -> Sequence[str]:
        """Return the models that choose the rights in a document, each by its own comparison of names."""

    @abstractmethod
    def trusting_any_signer(self) -> Sequence[str]:
        """Return the models that take a document whose signer the right authority certified as anybody at all."""

    @abstractmethod
    def excess(self, task: PresentationTask) -> Sequence[ExcessRights]:
        """Return every holder and document by which an implementation permits more than the policy."""

    @abstractmethod
    def compared_with(self, content: bytes, name: str, package: Package) -> DocumentComparison:
        """Compare a signed document, as the transport's standard reads it, with the rules of a package.

        Args:
            content: what is signed.
            name: distinguished name of the certificate that it is presented with; see :attr:`keymint.api.Holder.name`.
            package: the package.

        Raises:
            KeymintError: a rule cannot be mapped. A document that cannot be read is ``unknown``.
        """


class BuildType(ABC):
    """Builds a transport's documents from a package, and signs and checks them.

    A package may have several build types. Their files lie in one enclave; ``cert.pem`` and ``key.pem``, the identity
    and its private key, are common to all. What has a default is optional.
    """

    API: str
    TRANSPORT: str
    """Short unique name of the transport, for ``keymint init --transport``."""
    LAYOUTS: Mapping[str, Layout]
    """The layouts of the install space that it supports, by name; build types agree on the folder of enclaves."""
    READS: tuple[str, ...]
    """Suffixes of the files that the transport reads from an enclave, also through links.

    The transport may read such a file although it cannot be read here, so nothing is claimed about an enclave with one.
    """
    KINDS: tuple[str, ...]
    """The kinds of rules that it can express, keys of :data:`comarmor.rules.PERMISSIONS`; others are not asked."""
    PARTS: tuple[str, ...] = ()
    """Names of the parts of a package that it reads beside identity and grant. The document of a part is usually
    ``<name>.xml`` in the package, and its defaults are ``package.defaults/<name>.xml``."""
    COPIED: tuple[str, ...] = ()
    """Names of the files of an enclave that :meth:`shared` looks at."""
    prover: Prover | None = None
    """Proves claims about installed enclaves."""
    presentation: Presentation | None = None
    """What is known about the signed documents that its enclaves present to each other, if they do."""
    keystores: KeystoreReader | None = None
    """Reads keystores and documents that other tools made."""
    names: NameMapping | None = None
    """Maps names of the application to those of the transport, if these differ."""

    def settings(self, sources: PackageSources) -> PackageSettings:
        """Read the parts of a package.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return PackageSettings(None)

    @abstractmethod
    def files(self, layout: str) -> frozenset[str]:
        """Return the names of all files of it that may lie in an enclave; others are reported as unexpected."""

    @abstractmethod
    def authorities(self, package: Package) -> Sequence[AuthorityRole]:
        """Return the authorities that the enclave of a package rests on, one for each role.

        Raises:
            KeymintError: the package names several authorities where the transport has one.
        """

    @abstractmethod
    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        """Return the unsigned documents of a package; a pure function of its arguments.

        Raises:
            KeymintError: the transport cannot express a rule; with the rule's ``file:line``.
        """

    @abstractmethod
    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: Credentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """Return the files of the enclave by name, with signed documents.

        Args:
            package: the package.
            documents: unsigned documents of the build space, which may have been edited by hand; those of the package's
                other build types are among them.
            credentials: keys and certificates.
            layout: name of the layout, one of :attr:`LAYOUTS`.
            installed: the enclave's current files; a signed file whose content and signer are unchanged is returned
                unchanged.

        Raises:
            KeymintError: a document violates its schema.
        """

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        """Return copies of enclaves' files that a layout has outside of them, by path relative to the install space.

        Args:
            artifacts: artifacts by subject, then file name; those that :attr:`COPIED` names.
            layout: name of the layout.
        """
        return {}

    @abstractmethod
    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """Return findings on one installed enclave; their codes are stable."""

    def check_all(self, inspections: Sequence[Inspection]) -> Sequence[Diagnostic]:
        """Return findings that involve several enclaves, e.g. names that a vendor confuses."""
        return ()

    # -- what its transport does ---------------------------------------------------------------------------------------

    KNOWS_COMMON_NAMES_ONLY: bool = False
    """It knows a subject by a common name alone.

    Then the common name has the generation (:attr:`Issuance.generation`), so that a revoked identity loses its rights.
    """

    def revocation_files(self, distro: str, layout: str, revocations: bytes) -> Mapping[str, Artifact] | None:
        """Return the files with which an enclave has a revocation list, by name; empty if the transport reads none.

        None if it has no such lists at all.

        Args:
            distro: the ROS 2 distribution.
            layout: name of the layout.
            revocations: the list, PEM.
        """
        return None

    def keystore_variables(self, distro: str, layout: str) -> Sequence[EnvironmentVariable]:
        """Return the variables that all processes of a robot have.

        Args:
            distro: the ROS 2 distribution.
            layout: name of the layout.
        """
        return ()

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
        return ()

    def implementations(self) -> Sequence[Implementation]:
        """Return the implementations of the transport that were measured; otherwise all subjects change together."""
        return ()

    def distro_of(self, paths: Iterable[str], content: Callable[[str], bytes | None]) -> str:
        """Return the distribution of the signed documents among some files, or an empty text if they do not tell it.

        Args:
            paths: the paths of the files.
            content: returns the content of a file; None if it cannot be read.
        """
        return ""

    INFRASTRUCTURE: bool = False
    """It needs identities that are no subjects of the policy.

    The documents of such a workspace may name files by their absolute path, so they are built again when it moves.
    """

    def packages(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        """Return the packages that a workspace needs for them: by name, what each is for, e.g. ``the broker``.

        Raises:
            KeymintError: with ``file:line`` of a defect of the profile, or the transport cannot serve it.
        """
        return {}

    # -- which names and rules it has ----------------------------------------------------------------------------------

    NOUN: str = ""
    """The word for the names of its endpoints, e.g. ``topic``; empty if :meth:`actions` is not to be asked."""

    def actions(self, distro: str, edge: Edge) -> Sequence[Endpoint]:
        """Return the endpoints that the transport must all permit for an edge.

        There are none if no name on the transport can stand for the object; the transport is not asked about it.

        Args:
            distro: ROS 2 distribution whose name mapping applies.
            edge: an edge of a kind that the build type can express.

        Raises:
            KeymintError: the distribution or the permission is not known.
        """
        return ()

    def installed_names(self, enclave: InstalledEnclave) -> Sequence[str]:
        """Return expressions of application names like those in the shared documents; none if these cannot be read."""
        return ()

    def check_rules(self, rules: SubjectRules, distro: str) -> Sequence[Diagnostic] | None:
        """Return the rules that it cannot express, that implementations read differently, or that have no effect.

        Args:
            rules: the policy's rules for a subject.
            distro: ROS 2 distribution whose name mapping applies.

        Returns:
            Findings at the place of a rule, with stable codes; their severity is that of a build. None if it checks no
            rules without a package.
        """
        return None

    def check_node(self, rules: SubjectRules, distro: str) -> Iterable[Diagnostic]:
        """Return notes on what cannot start with default options, each with a stable code and the subject.

        Args:
            rules: the rules of a subject.
            distro: ROS 2 distribution of its nodes.
        """
        return ()

    # -- which software reads its files --------------------------------------------------------------------------------

    def models(self, distro: str = "") -> Mapping[str, str]:
        """Return how each model that claims are made for is known: specified, measured, or from sources.

        A simulated transport may have the name of a model.

        Args:
            distro: the ROS 2 distribution; empty for all models.
        """
        return {}

    VENDORS: tuple[str, ...] = ()
    """Names of the vendors that advisories are known for."""

    def installed_vendors(self, environment: Mapping[str, str]) -> Mapping[str, Sequence[str]]:
        """Return the versions of each vendor that are installed on this machine; none that is not found.

        Args:
            environment: variables, of which some name folders of installed software.
        """
        return {}

    def advisories(self, vendor: str, version: str) -> Sequence[Diagnostic]:
        """Return a finding for each known vulnerability of access control that affects a version of a vendor."""
        return ()

    # -- documents over all packages, where one place decides for all of them ------------------------------------------

    SHARES: bool = False
    """It has such documents, and the four methods below.

    Their paths are relative to the install space. The files that belong to a document have its path, perhaps with a
    suffix: ``rights/all.json`` and ``rights/all.json.sig``. No path begins with the folder of enclaves.
    """

    def build_shared(self, packages: Sequence[Package], options: BuildOptions) -> BuildResult:
        """Return the unsigned documents by path; a pure function of its arguments.

        Args:
            packages: all packages of the workspace that have the build type, infrastructure included, sorted by name.
            options: options of the build.

        Raises:
            KeymintError: the packages contradict each other; with the ``file:line`` of both.
        """
        return BuildResult({})

    def install_shared(
        self,
        packages: Sequence[Package],
        documents: Mapping[str, bytes],
        credentials: Credentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """Return the files to install by path: the documents, and what belongs to them, e.g. signatures.

        Args:
            packages: as for :meth:`build_shared`.
            documents: unsigned documents of the build space by path, which may have been edited by hand.
            credentials: the authorities.
            layout: name of the layout.
            installed: the current files; a signature whose content and signer are unchanged is returned unchanged.

        Raises:
            KeymintError: a document violates its schema.
        """
        return {}

    def check_shared(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """Return findings on the installed shared documents; their codes are stable."""
        return ()

    def prove_shared(self, task: SharedProofTask) -> Sequence[Claim]:
        """Return the claims across subjects, e.g. that no receiver's rights include what another one's rules hide.

        Raises:
            KeymintError: a shared document cannot be read, or the anchors do not vouch for it.
        """
        return ()
