# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - defaults ignore their arguments
"""Package types: create and load source packages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from keymint.api.build_types import BuildType
from keymint.api.packages import Issuance, Package, Role
from keymint.api.profiles import WorkspaceProfile
from keymint.errors import Diagnostic, Origin
from keymint.ir import SubjectRules

if TYPE_CHECKING:
    from keymint.api.foreign_keystores import AdoptedSources


class PackageType(ABC):
    """Creates and loads source packages. What has a default is optional."""

    API: str
    MARKER: str
    """Name of the file that marks a folder as a package, e.g. ``keymint_package.xml``."""
    ISSUANCE: str = ""
    """Name of the file that has what an authority decided about the certificate, relative to the folder of a package.

    A package without it has the defaults; empty if the packages keep nothing about it.
    """

    @abstractmethod
    def create(
        self, profile: WorkspaceProfile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
    ) -> Mapping[str, bytes]:
        """Return the files to write for a package, by name relative to its folder.

        Existing files that belong to the user are omitted. The document of the rules is returned if it is missing or
        differs from the current policy.

        Raises:
            KeymintError: the document of the rules was edited by hand, the policy changed as well, and ``force`` is
                False.
        """

    @abstractmethod
    def create_infrastructure(
        self, profile: WorkspaceProfile, name: str, build_type: str, existing: Mapping[str, bytes]
    ) -> Mapping[str, bytes]:
        """Return the files to write for a package of the role :attr:`Role.INFRASTRUCTURE`, as :meth:`create` does.

        Args:
            profile: the profile of the workspace.
            name: package name.
            build_type: the build type that needs it, its only one.
            existing: the package's present files; empty for a new package.
        """

    @abstractmethod
    def role(self, manifest: bytes) -> Role:
        """Return why a package exists, from the file :attr:`MARKER`; that of a subject if this has defects."""

    @abstractmethod
    def load(
        self,
        profile: WorkspaceProfile,
        name: str,
        folder: str,
        files: Mapping[str, bytes],
        build_types: Callable[[str, Origin], BuildType],
        install_space: str,
        *,
        built: bool = False,
    ) -> Package:
        """Load a package from its files; omitted settings are taken from the profile's defaults.

        The build types of the package read their parts (:meth:`BuildType.settings`). The defects of all documents are
        reported together.

        Args:
            profile: the profile of the workspace.
            name: package name, from its path below the source space.
            folder: its folder as the user would type it, for messages.
            files: the package's files by name.
            build_types: returns a build type by its name, which is written at a place.
            install_space: absolute path of the install space on this machine.
            built: it was built from these files, so they have no defects. Its rules may be read when they are first
                asked for, and whether they were edited by hand (:attr:`keymint.api.Grant.edited`) may not be known.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def load_like(
        self,
        profile: WorkspaceProfile,
        like: Package,
        sources: Mapping[str, bytes],
        name: str,
        folder: str,
        files: Mapping[str, bytes],
    ) -> Package | None:
        """Load a package as :meth:`load` does, at less cost: from another one whose files differ in the rules only.

        Where the settings of build types are written may be told of the other package.

        Args:
            profile: the profile of the workspace.
            like: the other package.
            sources: its files by name.
            name: package name.
            folder: its folder as the user would type it.
            files: the files that :meth:`create` returned for it just now, by name.

        Returns:
            The package; None if the other one does not tell all.
        """
        return None

    def former_rules(self, rules: SubjectRules, files: Mapping[str, bytes]) -> Sequence[Diagnostic]:
        """Return what documents that will be replaced say and the rules do not, or the other way, as warnings.

        Args:
            rules: the policy's rules for the subject.
            files: the package's files by name; may have defects.
        """
        return ()

    def rule_places(self, name: str, folder: str, files: Mapping[str, bytes]) -> Sequence[Origin] | None:
        """Return the place of each rule in the package's own document, in their order; None if it has none.

        Args:
            name: package name.
            folder: its folder as the user would type it.
            files: the package's files by name.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return None

    def issuance(self, folder: str, files: Mapping[str, bytes]) -> Issuance:
        """Return what the authority decided about a package; the defaults if its files have nothing about it.

        Args:
            folder: its folder as the user would type it.
            files: the package's files by name; those beside :attr:`ISSUANCE` may be missing.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return Issuance()

    def with_issuance(self, issuance: Issuance) -> Mapping[str, bytes]:
        """Return the files to write into a package's folder, by name, so that it has this."""
        return {}

    def with_validity(
        self, profile: WorkspaceProfile, rules: SubjectRules, files: Mapping[str, bytes], valid_for: str, now: datetime
    ) -> Mapping[str, bytes] | None:
        """Give the certificate and the grant of a package a validity of their own, in its own documents.

        Args:
            profile: the profile of the workspace.
            rules: the policy's rules for the subject.
            files: the package's files by name, those to write included.
            valid_for: the length, an ISO 8601 duration such as ``P90D``.
            now: the clock, UTC.

        Returns:
            The files of the package that change, by name; empty if it has this length of validity already. None if
            packages have the validity of the profile only.

        Raises:
            KeymintError: its owner gave it another validity, or edited the documents by hand.
        """
        return None

    def with_unique_name(
        self, profile: WorkspaceProfile, name: str, files: Mapping[str, bytes]
    ) -> Mapping[str, bytes] | None:
        """Return the files of a package that change, by name, so that its subject name has a second, unique RDN.

        None if it cannot give a subject a name that no other name is taken for.

        Args:
            profile: the profile of the workspace.
            name: the package.
            files: its files by name.

        Raises:
            KeymintError: its owner wrote them in another way.
        """
        return None

    def adopted_sources(self, profile: WorkspaceProfile, sources: AdoptedSources) -> Mapping[str, bytes] | None:
        """Return the files of a new package for an enclave that another tool made; None if it cannot describe one."""
        return None
