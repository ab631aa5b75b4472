# SPDX-License-Identifier: Apache-2.0
"""The workspace format ``keymint_ros``: profiles and source packages as XML, for ROS 2."""

from __future__ import annotations

from keymint.api import API_VERSION, PackageType, ProfileType, lazy
from keymint_ros.manifest import BUILD_TYPE, ISSUANCE, MARKER, SIGNER

__all__ = ["RosPackageType", "RosProfileType", "package_type", "profile_type"]


class RosProfileType(ProfileType):
    """Profiles."""

    API = API_VERSION

    BUILD_TYPES = (BUILD_TYPE,)
    PLACES = {  # noqa: RUF012 - nobody changes it
        "domain": ("package.defaults/permissions.xml", "package.defaults/governance.xml"),
        "subject-format": ("package.defaults/permissions.xml", "package.defaults/identities.xml"),
        "valid-for": ("package.defaults/permissions.xml", "package.defaults/identities.xml"),
    }

    SETTINGS = ("distro", "domain", "subject-format", "valid-for")
    SIGNER = SIGNER

    bootstrap = lazy("keymint_ros.bootstrap:bootstrap")
    library = lazy("keymint_ros.distros:library")
    recognises = lazy("keymint_ros.profile_reader:recognises")
    load = lazy("keymint_ros.profile_reader:load")
    with_distro = lazy("keymint_ros.profile_reader:with_distro")
    with_policy = lazy("keymint_ros.profile_reader:with_policy")
    choices = lazy("keymint_ros.bootstrap:choices")
    settings = lazy("keymint_ros.profile_reader:settings")
    with_setting = lazy("keymint_ros.setting_edits:with_setting")
    with_own_signer = lazy("keymint_ros.package_writer:with_own_signer")
    with_authority_issuance = lazy("keymint_ros.decisions:with_authority_issuance")
    with_packages = lazy("keymint_ros.decisions:with_packages")


class RosPackageType(PackageType):
    """Source packages."""

    API = API_VERSION
    MARKER = MARKER
    ISSUANCE = ISSUANCE

    create = lazy("keymint_ros.package_writer:create")
    create_infrastructure = lazy("keymint_ros.package_writer:create_infrastructure")
    role = lazy("keymint_ros.manifest:role")
    load = lazy("keymint_ros.package_reader:load")
    load_like = lazy("keymint_ros.package_reader:load_like")
    former_rules = lazy("keymint_ros.package_writer:former_rules")
    rule_places = lazy("keymint_ros.package_reader:rule_places")
    with_validity = lazy("keymint_ros.package_writer:with_validity")
    with_unique_name = lazy("keymint_ros.package_writer:with_unique_name")
    adopted_sources = lazy("keymint_ros.package_writer:adopted_sources")
    issuance = lazy("keymint_ros.decisions:issuance")
    with_issuance = lazy("keymint_ros.decisions:with_issuance")


profile_type = RosProfileType()
package_type = RosPackageType()
