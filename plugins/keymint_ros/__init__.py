"""The workspace format ``keymint_ros``: profiles and source packages as XML, for ROS 2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from comarmor.errors import Origin
from keymint.api import API_VERSION, Bootstrap, Package, WorkspaceProfile
from keymint.ir import SubjectRules
from keymint_ros import bootstrap, create, distros, package, profile, settings
from keymint_ros.manifest import MARKER


class RosProfileType:
    """Profiles: see :class:`keymint.api.ProfileType`."""

    API = API_VERSION

    def bootstrap(self, request: Bootstrap) -> Mapping[str, bytes]:
        """Return the files of a new profile.

        Raises:
            KeymintError: the request names a distro, layout, subject format or domain that is not known.
        """
        return bootstrap.bootstrap(request)

    def library(self, distro: str) -> Path:
        """Return the folder of policy fragments that ship for a distro; it holds ``common/node.xml``.

        Raises:
            KeymintError: the distro is not known.
        """
        return distros.library(distro)

    def recognises(self, files: Mapping[str, bytes]) -> bool:
        """Tell whether these files of a profile space are of this type."""
        return profile.MANIFEST in files

    def load(self, root: Path, files: Mapping[str, bytes]) -> WorkspaceProfile:
        """Load a profile from its files.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return profile.load(root, files)

    def with_policy(self, files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
        """Return the files that change when the profile is bound to another policy path.

        Raises:
            KeymintError: the profile's list of policies was edited by hand.
        """
        return profile.with_policy(files, policy)

    def settings(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        """Return the value of each option of ``init``; see :class:`keymint.api.ProfileSettings`.

        Raises:
            KeymintError: the defaults of permissions have a defect, with its ``file:line``.
        """
        return settings.settings(profile)


class RosPackageType:
    """Source packages: see :class:`keymint.api.PackageType`."""

    API = API_VERSION
    MARKER = MARKER

    def create(
        self, profile: WorkspaceProfile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
    ) -> Mapping[str, bytes]:
        """Return the files to write for a package, by name relative to its folder.

        A ``permissions.xml`` in the format of 2018 is replaced, and kept as ``permissions.xml.2018``.

        Raises:
            KeymintError: the document of the rules was edited by hand (code ``hand-edited``), the policy changed as
                well, and ``force`` is not given.
        """
        return create.create(profile, rules, existing, force=force)

    def load(self, profile: WorkspaceProfile, name: str, folder: str, files: Mapping[str, bytes]) -> Package:
        """Load a package from its files; what it leaves out is taken from the profile's defaults.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """
        return package.load(profile, name, folder, files)

    def rule_places(self, name: str, folder: str, files: Mapping[str, bytes]) -> Sequence[Origin]:
        """Return the place in ``permissions.xml`` of each rule of a package; see :class:`keymint.api.RuleLocator`."""
        return package.rule_places(name, folder, files)


profile_type = RosProfileType()
package_type = RosPackageType()
