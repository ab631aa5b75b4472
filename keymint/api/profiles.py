# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 - defaults ignore their arguments
"""Profile types: bootstrap and load the profile of a workspace."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path

from comarmor.values import Data, field
from keymint.api.packages import Authority, AuthorityIssuance, Validity
from keymint.api.policies import PolicySource


class AcceptedPackage(Data):
    """What the owner of a workspace accepted of the profiles that a ROS package ships.

    Attributes:
        files: SHA-256 of each accepted file, in hex, by its path below the package's folder of profiles.
        follows_links: symbolic links in that folder may lead out of it.
    """

    files: Mapping[str, str]
    follows_links: bool = False


class WorkspaceProfile(Data):
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
        renamed: elements by which its documents call what has another name now, with that name.
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
    renamed: Mapping[str, str] = field(default_factory=dict)
    revoke_superseded: bool = False
    packages: Mapping[str, AcceptedPackage] = field(default_factory=dict)
    package_copies: Path | None = None
    distro_named: bool = True


class Bootstrap(Data):
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


class ProfileType(ABC):
    """Creates and loads the profile space of a workspace. What has a default is optional."""

    API: str
    BUILD_TYPES: tuple[str, ...]
    """Build types of a new profile whose request names none."""
    PLACES: Mapping[str, tuple[str, ...]] = {}
    """Files that give a setting together, relative to the profile space; those not listed are in the marker."""
    SETTINGS: Sequence[str] = ()
    """The settings that :meth:`with_setting` changes, by the names of :meth:`settings`."""
    SIGNER: str = ""
    """Name of the authority that :meth:`with_own_signer` makes; empty if it makes none."""

    @abstractmethod
    def bootstrap(self, request: Bootstrap) -> Mapping[str, bytes]:
        """Return the files of a new profile by path relative to the profile space.

        Raises:
            KeymintError: the distro or layout is unknown.
        """

    @abstractmethod
    def library(self, distro: str) -> Path:
        """Return the folder of the policy library for a distro, which ``bootstrap`` copies into the profile."""

    @abstractmethod
    def with_distro(self, profile: WorkspaceProfile, distro: str) -> WorkspaceProfile:
        """Return a profile that names no distribution with one, and with its layout unless it names that."""

    @abstractmethod
    def recognises(self, files: Mapping[str, bytes]) -> bool:
        """Whether the files of a profile space are of this type."""

    @abstractmethod
    def load(self, root: Path, files: Mapping[str, bytes]) -> WorkspaceProfile:
        """Load a profile from its files.

        Args:
            root: the profile space, to resolve the policy's path and for places in messages.
            files: XML files of the profile space by relative path.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    @abstractmethod
    def with_policy(self, files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
        """Return the files that change when the profile is set to another policy path.

        Raises:
            KeymintError: the profile's list of policies was edited by hand, and is not overwritten.
        """

    def choices(self, option: str) -> Iterable[str]:
        """Return the values that an option of ``keymint init`` may have, for the shell to offer.

        Args:
            option: its name, ``distro`` or ``subject-format``.
        """
        return ()

    def settings(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        """Return the current value of each option of ``keymint init`` as text, by the option's name.

        The names are ``distro``, ``domain``, …. Options that the profile type does not have are omitted.

        Raises:
            KeymintError: with ``file:line`` of a defect.
        """
        return {}

    def with_setting(self, profile: WorkspaceProfile, name: str, value: str, now: datetime) -> Mapping[str, bytes]:
        """Return the files of a profile that change, by path, so that a setting has another value; comments stay.

        What its owner wrote in a way that is not edited is left out; the caller looks whether the value is there.

        Args:
            profile: the profile.
            name: one of :attr:`SETTINGS`.
            value: its new value, as the option of ``keymint init`` takes it.
            now: the clock, UTC.

        Raises:
            KeymintError: it has no such value.
        """
        raise NotImplementedError

    def with_authority_issuance(self, issuance: Mapping[str, AuthorityIssuance]) -> Mapping[str, bytes] | None:
        """Return the files to write into the profile space so that it has this; None if it keeps none of it.

        :meth:`load` returns it as :attr:`keymint.api.Authority.issuance`, applied to the certificate.

        Args:
            issuance: what was decided, by authority; those without any decision may be omitted.
        """
        return None

    def with_packages(self, packages: Mapping[str, AcceptedPackage]) -> Mapping[str, bytes] | None:
        """Return the files to write into the profile space so that it has this, beside the copies.

        None if it keeps none of it. :meth:`load` returns it as :attr:`WorkspaceProfile.packages`.

        Args:
            packages: what was accepted, by package.
        """
        return None

    def with_own_signer(
        self, profile: WorkspaceProfile, former: str, validity: Validity | None = None
    ) -> Mapping[str, bytes]:
        """Return the files of a profile that change, by path, so that a new authority signs the documents.

        Args:
            profile: the profile.
            former: the authority that signs them now.
            validity: the period of the new authority's certificate; None for that of the defaults.

        Raises:
            KeymintError: its owner wrote them in another way.
        """
        raise NotImplementedError
