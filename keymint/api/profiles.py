"""Profiles of workspaces, and what bootstraps and loads them and their packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Protocol, runtime_checkable

from comarmor.errors import Origin
from keymint.api.certificates import Authority
from keymint.api.packages import Package
from keymint.ir import SubjectRules


@dataclass(frozen=True, slots=True)
class PolicySource:
    """A policy that the profile names: a file or a directory, and where else its includes may be found."""

    name: str
    path: Path
    origin: Origin


@dataclass(frozen=True, slots=True)
class WorkspaceProfile:
    """A workspace profile, loaded.

    Attributes:
        name: the profile's name.
        profile_type: the plugin that loaded it.
        policy_type: the plugin that acquires policy.
        package_type: the plugin that creates packages.
        policies: the policies in the order of the profile.
        library: a folder in which includes are looked up that the including file's own folder lacks.
        authorities: in the order of the profile; an issuer stands anywhere.
        layout: ``sros2`` or ``flat``: the layout of the install space.
        distro: ROS 2 distribution.
        files: files of the profile by path relative to the profile space (for plugins of the same format).
        accepts: names of what the owner accepts although it weakens what the policy says, e.g. ``open_governance``.
    """

    name: str
    profile_type: str
    policy_type: str
    package_type: str
    policies: tuple[PolicySource, ...]
    library: Path | None
    authorities: tuple[Authority, ...]
    layout: str
    distro: str
    files: Mapping[str, bytes] = field(repr=False)
    accepts: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Bootstrap:
    """What ``keymint init`` was asked for.

    Attributes:
        name: name of the new profile.
        policy: path to write into ``policies.xml``, as text, relative to the profile space or absolute; empty for
            the example policy that the profile type brings along.
        distro: ROS 2 distribution.
        domain: DDS domain id.
        layout: ``sros2`` or ``flat``; empty for what the distro takes.
        subject_format: ``unique`` (a second RDN that no other subject has) or ``sros2`` (the bare CN).
        now: the clock, UTC.
    """

    name: str
    policy: str
    distro: str
    domain: int
    layout: str
    subject_format: str
    now: datetime


class ProfileType(Protocol):
    """Bootstraps and loads the profile space of a workspace."""

    API: str

    def bootstrap(self, request: Bootstrap) -> Mapping[str, bytes]:
        """Return the files of a new profile by path relative to the profile space.

        Raises:
            KeymintError: the request names a distro or layout that is not known.
        """

    def library(self, distro: str) -> Path:
        """Return the folder of shipped policy fragments of a distro (what ``bootstrap`` copies into the profile)."""

    def recognises(self, files: Mapping[str, bytes]) -> bool:
        """Tell whether these files of a profile space are of this type."""

    def load(self, root: Path, files: Mapping[str, bytes]) -> WorkspaceProfile:
        """Load a profile from its files.

        Args:
            root: the profile space; only to resolve the policy's path and to name places in messages.
            files: XML files of the profile space by relative path.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def with_policy(self, files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
        """Return the files that change when the profile is bound to another policy path.

        Raises:
            KeymintError: the profile's list of policies was edited by hand, so that it is not ours to change.
        """


@runtime_checkable
class ProfileSettings(Protocol):
    """What a profile type may offer beside :class:`ProfileType`: the settings that ``keymint init`` has options for."""

    def settings(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        """Return the present value of each option, as text, by the option's name (``distro``, ``domain``, …).

        An option that is left out is not a setting of this profile type.

        Raises:
            KeymintError: with ``file:line`` of a defect.
        """


class PackageType(Protocol):
    """Creates and loads source packages."""

    API: str
    MARKER: str
    """Name of the file that makes a folder a package, e.g. ``keymint_package.xml``."""

    def create(
        self, profile: WorkspaceProfile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
    ) -> Mapping[str, bytes]:
        """Return the files to write for a package, by name relative to its folder.

        Files that exist and belong to the user are left out. The document of the rules is returned when it is
        missing or its content differs from what the policy says now.

        Raises:
            KeymintError: the document of the rules was edited by hand, the policy changed as well, and ``force``
                is not given.
        """

    def load(self, profile: WorkspaceProfile, name: str, folder: str, files: Mapping[str, bytes]) -> Package:
        """Load a package from its files; what it leaves out is taken from the profile's defaults.

        Args:
            profile: the profile of the workspace.
            name: package name, from its place under the source space.
            folder: its folder as the user would type it, for messages.
            files: the package's files by name.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


@runtime_checkable
class RuleLocator(Protocol):
    """What a package type may offer beside :class:`PackageType`: where the rules of a package stand in its files."""

    def rule_places(self, name: str, folder: str, files: Mapping[str, bytes]) -> Sequence[Origin]:
        """Return the place in the package's own document of each of its rules, in their order.

        Args:
            name: package name.
            folder: its folder as the user would type it.
            files: the package's files by name.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
