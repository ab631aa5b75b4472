# SPDX-License-Identifier: Apache-2.0
"""Profile types and package types: bootstrap and load the profile and the source packages of a workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from datetime import datetime
from pathlib import Path
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic, Origin
from comarmor.values import dataclass
from keymint.api.build_types import BuildType
from keymint.api.certificates import Authority, AuthorityIssuance
from keymint.api.packages import Issuance, Package, Role
from keymint.api.policies import PolicySource
from keymint.ir import SubjectRules


@dataclass(frozen=True, slots=True)
class AcceptedPackage:
    """What the owner of a workspace accepted of the profiles that a ROS package ships.

    Attributes:
        files: SHA-256 of each accepted file, in hex, by its path below the package's folder of profiles.
        follows_links: symbolic links in that folder may lead out of it.
    """

    files: Mapping[str, str]
    follows_links: bool = False


@dataclass(frozen=True, slots=True)
class WorkspaceProfile:
    """A loaded workspace profile.

    Attributes:
        name: the profile's name.
        profile_type: the plugin that loaded it.
        policy_type: the plugin that acquires policy.
        package_type: the plugin that creates packages.
        policies: the policies in the order of the profile.
        library: folder that is searched for included files which the policy's folder lacks.
        authorities: in the order of the profile; issuers need not come first.
        build_types: the plugins that build new packages.
        layout: name of the layout of the install space (:attr:`BuildType.LAYOUTS`).
        distro: ROS 2 distribution.
        files: files of the profile by path relative to the profile space (for plugins of the same format).
        accepts: weakenings of the policy that the owner accepts, as build types call them.
        revoke_superseded: a certificate is revoked where new signed rights are narrower than those it had.
        packages: what the owner accepted of the profiles that ROS packages ship, by package.
        package_copies: the folder of copies of what was accepted, a folder for each package; None if it has none.
        distro_named: it names its distribution; otherwise it has the one of installed documents, or a usual one.
    """

    name: str
    profile_type: str
    policy_type: str
    package_type: str
    policies: tuple[PolicySource, ...]
    library: Path | None
    authorities: tuple[Authority, ...]
    build_types: tuple[str, ...]
    layout: str
    distro: str
    files: Mapping[str, bytes] = field(repr=False)
    accepts: frozenset[str] = frozenset()
    revoke_superseded: bool = False
    packages: Mapping[str, AcceptedPackage] = field(default_factory=dict)
    package_copies: Path | None = None
    distro_named: bool = True


@dataclass(frozen=True, slots=True)
class Bootstrap:
    """A request to create a profile, from the options of ``keymint init``.

    Attributes:
        name: name of the new profile.
        policy: path to write into ``policies.xml``, as text, relative to the profile space or absolute; empty for
            the example policy of the profile type.
        distro: ROS 2 distribution.
        domain: domain id.
        layout: name of a layout; empty for the layout that the distro reads.
        subject_format: form of subject names, as the profile type calls it, e.g. ``unique`` (with a second RDN that is
            unique to the subject).
        now: the clock, UTC.
        build_types: the plugins that build new packages; empty for those of the profile type.
        valid_for: length of the validity of packages' certificates and grants, an ISO 8601 duration such as ``P90D``;
            empty for that of the profile type.
        authority: name of the one authority that issues identities and signs documents; empty for those of the layout.
        policy_type: the plugin that loads the policy; empty for that of the profile type.
    """

    name: str
    policy: str
    distro: str
    domain: int
    layout: str
    subject_format: str
    now: datetime
    build_types: tuple[str, ...] = ()
    valid_for: str = ""
    authority: str = ""
    policy_type: str = ""


class ProfileType(Protocol):
    """Creates and loads the profile space of a workspace."""

    API: str
    BUILD_TYPES: tuple[str, ...]
    """Build types of a new profile whose request names none."""

    def bootstrap(self, request: Bootstrap) -> Mapping[str, bytes]:
        """Return the files of a new profile by path relative to the profile space.

        Raises:
            KeymintError: the distro or layout is unknown.
        """

    def library(self, distro: str) -> Path:
        """Return the folder of the policy library for a distro, which ``bootstrap`` copies into the profile."""

    def with_distro(self, profile: WorkspaceProfile, distro: str) -> WorkspaceProfile:
        """Return a profile that names no distribution with one, and with its layout unless it names that."""

    def recognises(self, files: Mapping[str, bytes]) -> bool:
        """Whether the files of a profile space are of this type."""

    def load(self, root: Path, files: Mapping[str, bytes]) -> WorkspaceProfile:
        """Load a profile from its files.

        Args:
            root: the profile space, to resolve the policy's path and for places in messages.
            files: XML files of the profile space by relative path.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def with_policy(self, files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
        """Return the files that change when the profile is set to another policy path.

        Raises:
            KeymintError: the profile's list of policies was edited by hand, and is not overwritten.
        """


@runtime_checkable
class ProfileSettings(Protocol):
    """Optional capability of a profile type: returns the settings that ``keymint init`` has options for."""

    PLACES: Mapping[str, tuple[str, ...]]
    """Files that give a setting together, relative to the profile space; those not listed are in the marker."""

    def settings(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        """Return the current value of each option as text, by the option's name (``distro``, ``domain``, …).

        Options that the profile type does not have are omitted.

        Raises:
            KeymintError: with ``file:line`` of a defect.
        """


@runtime_checkable
class AuthorityIssuanceFiles(Protocol):
    """Optional capability of a profile type: keeps what was decided about the authorities' certificates.

    :meth:`ProfileType.load` returns it as :attr:`keymint.api.Authority.issuance`, applied to the certificate.
    """

    def with_authority_issuance(self, issuance: Mapping[str, AuthorityIssuance]) -> Mapping[str, bytes]:
        """Return the files to write into the profile space so that it has this.

        Args:
            issuance: what was decided, by authority; those without any decision may be omitted.
        """


@runtime_checkable
class AcceptedPackageFiles(Protocol):
    """Optional capability of a profile type: keeps what the owner accepted of the profiles that ROS packages ship.

    :meth:`ProfileType.load` returns it as :attr:`WorkspaceProfile.packages`.
    """

    def with_packages(self, packages: Mapping[str, AcceptedPackage]) -> Mapping[str, bytes]:
        """Return the files to write into the profile space so that it has this, beside the copies.

        Args:
            packages: what was accepted, by package.
        """


@dataclass(frozen=True, slots=True)
class InfrastructurePackage:
    """A package that a transport needs beside those of the subjects.

    Attributes:
        name: package name.
        title: what it is for, as part of a sentence, e.g. ``the broker``.
    """

    name: str
    title: str


@runtime_checkable
class Infrastructure(Protocol):
    """Optional capability of a build type: its transport needs identities that are no subjects of the policy.

    The documents of such a workspace may name files by their absolute path, so they are built again when it moves.
    """

    def packages(self, profile: WorkspaceProfile) -> Sequence[InfrastructurePackage]:
        """Return the packages that a workspace needs for them.

        Raises:
            KeymintError: with ``file:line`` of a defect of the profile, or the transport cannot serve it.
        """


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
