# SPDX-License-Identifier: Apache-2.0
"""Package types: create and load source packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic, Origin
from keymint.api.build_types import BuildType
from keymint.api.packages import Issuance, Package, Role
from keymint.api.profiles import WorkspaceProfile
from keymint.ir import SubjectRules


class PackageType(Protocol):
    """Creates and loads source packages."""

    API: str
    MARKER: str
    """Name of the file that marks a folder as a package, e.g. ``keymint_package.xml``."""

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

    def role(self, manifest: bytes) -> Role:
        """Return why a package exists, from the file :attr:`MARKER`; that of a subject if this has defects."""

    def load(
        self,
        profile: WorkspaceProfile,
        name: str,
        folder: str,
        files: Mapping[str, bytes],
        build_types: Callable[[str, Origin], BuildType],
        install_space: str,
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

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


@runtime_checkable
class BuiltPackageType(Protocol):
    """Optional capability of a package type: loads a package that was built without reading its rules."""

    def load_built(
        self,
        profile: WorkspaceProfile,
        name: str,
        folder: str,
        files: Mapping[str, bytes],
        build_types: Callable[[str, Origin], BuildType],
        install_space: str,
    ) -> Package:
        """Return what :meth:`PackageType.load` returns, but the rules are read when they are first asked for.

        Whether they were edited by hand (:attr:`keymint.api.Grant.edited`) may not be known.

        Args:
            profile: the profile of the workspace.
            name: package name.
            folder: its folder as the user would type it, for messages.
            files: the package's files by name, from which it was built before: they have no defects.
            build_types: returns a build type by its name, which is written at a place.
            install_space: absolute path of the install space on this machine.
        """


@runtime_checkable
class FormerRules(Protocol):
    """Optional capability of a package type: compares documents of former versions before they are replaced."""

    def former_rules(self, rules: SubjectRules, files: Mapping[str, bytes]) -> Sequence[Diagnostic]:
        """Return what documents that will be replaced say and the rules do not, or the other way, as warnings.

        Args:
            rules: the policy's rules for the subject.
            files: the package's files by name; may have defects.
        """


@runtime_checkable
class RuleLocator(Protocol):
    """Optional capability of a package type: locates the rules of a package in its files."""

    def rule_places(self, name: str, folder: str, files: Mapping[str, bytes]) -> Sequence[Origin]:
        """Return the place of each rule in the package's own document, in their order.

        Args:
            name: package name.
            folder: its folder as the user would type it.
            files: the package's files by name.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


@runtime_checkable
class IssuanceFiles(Protocol):
    """Optional capability of a package type: keeps in a package what an authority decided about its certificate."""

    ISSUANCE: str
    """Name of the file that has it, relative to the folder of a package; a package without it has the defaults."""

    def issuance(self, folder: str, files: Mapping[str, bytes]) -> Issuance:
        """Return what the authority decided about a package; the defaults if its files have nothing about it.

        Args:
            folder: its folder as the user would type it.
            files: the package's files by name; those beside :attr:`ISSUANCE` may be missing.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def with_issuance(self, issuance: Issuance) -> Mapping[str, bytes]:
        """Return the files to write into a package's folder, by name, so that it has this."""


@runtime_checkable
class OwnValidity(Protocol):
    """Optional capability of a package type: gives the certificate and the grant of a package a validity of their own.

    It differs from the defaults of the profile, and stands in the package's own documents.
    """

    def with_validity(
        self, profile: WorkspaceProfile, rules: SubjectRules, files: Mapping[str, bytes], valid_for: str, now: datetime
    ) -> Mapping[str, bytes]:
        """Return the files of a package that change, by name; none if it has this length of validity already.

        Args:
            profile: the profile of the workspace.
            rules: the policy's rules for the subject.
            files: the package's files by name, those to write included.
            valid_for: the length, an ISO 8601 duration such as ``P90D``.
            now: the clock, UTC.

        Raises:
            KeymintError: its owner gave it another validity, or edited the documents by hand.
        """
