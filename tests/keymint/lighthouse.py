# SPDX-License-Identifier: Apache-2.0
"""A transport for tests that needs an identity beside those of the subjects: that of its lighthouse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comarmor.errors import Diagnostic, Severity
from keymint.api import (
    BuildOptions,
    BuildResult,
    Extension,
    Package,
    PackageSettings,
    PackageSources,
    Role,
    WorkspaceProfile,
)
from keymint.api.plugin_loader import PluginInfo
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests.keymint.plain_build_type import PlainBuildType

NAME = "lighthouse"
TOWER = "tower"
"""Name of the package of infrastructure; ``package.defaults/lighthouse.xml`` of the profile may have another."""


class LighthouseBuildType(PlainBuildType):
    TRANSPORT = "light"
    INFRASTRUCTURE = True
    PARTS = ("lighthouse",)
    DOCUMENT = "light.txt"
    KINDS = ("ros_topic",)

    def packages(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        if profile.distro == "foxy":
            raise KeymintError("there is no light in foxy", help="use a later distribution", code="light-distro")
        name = profile.files.get("package.defaults/lighthouse.xml", TOWER.encode()).decode()
        return {name: "the lighthouse"}

    def settings(self, sources: PackageSources) -> PackageSettings:
        lamp = sources.role is Role.INFRASTRUCTURE
        at = sources.install_space
        usage = "serverAuth" if lamp else "clientAuth"
        return PackageSettings(at, (Extension("extendedKeyUsage", usage, False, sources.parts["lighthouse"].where),))

    def check_rules(self, rules: SubjectRules, distro: str) -> Sequence[Diagnostic]:
        dark = [rule for rule in rules.rules if rule.kind != "ros_topic"]
        message = f"light carries no {{}} in {distro}"
        return [Diagnostic("light-kind", Severity.ERROR, message.format(each.kind), each.origin) for each in dark]

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        del options
        towers = [str(package.settings[NAME]), *(each.identity.subject_name for each in package.infrastructure)]
        return BuildResult(
            {"light.txt": "\n".join([*towers, *(str(each) for each in package.grant.rules.rules)]).encode()}
        )


build_type = LighthouseBuildType()
ENTRIES = (PluginInfo("keymint.build_types", NAME, f"{__name__}:build_type"),)
