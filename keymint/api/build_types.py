# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - defaults ignore their arguments
"""Build types: build unsigned documents of a package, sign and install them, check and prove installed enclaves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

from comarmor.errors import Diagnostic
from keymint.api.building import (
    Artifact,
    AuthorityRole,
    BuildOptions,
    BuildResult,
    EnclaveCredentials,
    Inspection,
    Layout,
    SharedCredentials,
    SharedInspection,
)
from keymint.api.packages import Package, PackageSettings, PackageSources
from keymint.api.proving import Claim, SharedProofTask


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
        credentials: EnclaveCredentials,
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

    # -- documents over all packages, where one place decides for all of them -----------------------------------------

    SHARES: ClassVar[bool] = False
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
        credentials: SharedCredentials,
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

    def check_shared(self, inspection: SharedInspection) -> Sequence[Diagnostic]:
        """Return findings on the installed shared documents; their codes are stable."""
        return ()

    def prove_shared(self, task: SharedProofTask) -> Sequence[Claim]:
        """Return the claims across subjects, e.g. that no receiver's rights include what another one's rules hide.

        Raises:
            KeymintError: a shared document cannot be read, or the anchors do not vouch for it.
        """
        return ()
