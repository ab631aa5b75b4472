# SPDX-License-Identifier: Apache-2.0
"""A transport for tests that needs an identity beside those of the subjects: that of its lighthouse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comarmor.errors import Diagnostic, Severity
from keymint.api import (
    API_VERSION,
    Artifact,
    AuthorityRole,
    BuildOptions,
    BuildResult,
    EnclaveCredentials,
    Extension,
    InfrastructurePackage,
    Inspection,
    Layout,
    Package,
    PackageSettings,
    PackageSources,
    Role,
    WorkspaceProfile,
)
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.plugins import PluginInfo

NAME = "lighthouse"
TOWER = "tower"
"""Name of the package of infrastructure; ``package.defaults/lighthouse.xml`` of the profile may have another."""


class LighthouseBuildType:
    """Implements :class:`keymint.api.BuildType`, with :class:`Infrastructure` and :class:`RuleCheck`."""

    API = API_VERSION
    TRANSPORT = "light"
    PARTS = ("lighthouse",)
    COPIED = ()
    LAYOUTS: Mapping[str, Layout] = {"sros2": Layout("enclaves")}
    READS = (".pem",)
    KINDS = ("ros_topic",)

    def packages(self, profile: WorkspaceProfile) -> Sequence[InfrastructurePackage]:
        if profile.distro == "foxy":
            raise KeymintError("there is no light in foxy", help="use a later distribution", code="light-distro")
        name = profile.files.get("package.defaults/lighthouse.xml", TOWER.encode()).decode()
        return (InfrastructurePackage(name, "the lighthouse"),)

    def settings(self, sources: PackageSources) -> PackageSettings:
        lamp = sources.role is Role.INFRASTRUCTURE
        at = sources.install_space
        usage = "serverAuth" if lamp else "clientAuth"
        return PackageSettings(at, (Extension("extendedKeyUsage", usage, False, sources.parts["lighthouse"].where),))

    def check_rules(self, rules: SubjectRules, distro: str) -> Sequence[Diagnostic]:
        dark = [rule for rule in rules.rules if rule.kind != "ros_topic"]
        message = f"light carries no {{}} in {distro}"
        return [Diagnostic("light-kind", Severity.ERROR, message.format(each.kind), each.origin) for each in dark]

    def files(self, layout: str) -> frozenset[str]:
        del layout
        return frozenset(("light.txt", "cert.pem", "key.pem"))

    def authorities(self, package: Package) -> Sequence[AuthorityRole]:
        return (AuthorityRole("identity", package.identity.issuer, package.identity.origin),)

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        del options
        towers = [str(package.settings[NAME]), *(each.identity.subject_name for each in package.infrastructure)]
        return BuildResult(
            {"light.txt": "\n".join([*towers, *(str(each) for each in package.grant.rules.rules)]).encode()}
        )

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: EnclaveCredentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        del package, layout, installed
        return {
            "light.txt": Artifact(documents["light.txt"]),
            "cert.pem": Artifact(credentials.certificate),
            "key.pem": Artifact(credentials.key, secret=True),
        }

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        del artifacts, layout
        return {}

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        del inspection
        return ()

    def check_all(self, inspections: Sequence[Inspection]) -> Sequence[Diagnostic]:
        del inspections
        return ()


build_type = LighthouseBuildType()
ENTRIES = (PluginInfo("keymint.build_types", NAME, f"{__name__}:build_type"),)
