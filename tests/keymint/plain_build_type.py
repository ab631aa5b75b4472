# SPDX-License-Identifier: Apache-2.0
"""What the build types of tests have in common: a document, a certificate and a key in each enclave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comarmor.errors import Diagnostic
from keymint.api import (
    API_VERSION,
    Artifact,
    AuthorityRole,
    BuildType,
    Credentials,
    Inspection,
    Layout,
    Package,
)


class PlainBuildType(BuildType):
    """A build type but for ``TRANSPORT``, the name of the document, and ``build``."""

    API = API_VERSION
    LAYOUTS: Mapping[str, Layout] = {"sros2": Layout("enclaves")}
    READS = (".pem",)
    KINDS: tuple[str, ...] = ("ros_topic", "ros_service", "ros_action", "ros_parameter")
    DOCUMENT: str

    def files(self, layout: str) -> frozenset[str]:
        del layout
        return frozenset((self.DOCUMENT, "cert.pem", "key.pem"))

    def authorities(self, package: Package) -> Sequence[AuthorityRole]:
        return (AuthorityRole("identity", package.identity.issuer, package.identity.origin),)

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: Credentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        del package, layout, installed
        return {
            self.DOCUMENT: Artifact(documents[self.DOCUMENT]),
            "cert.pem": Artifact(credentials.certificate),
            "key.pem": Artifact(credentials.key, secret=True),
        }

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        del inspection
        return ()
