"""A build type that is not part of Keymint: access rules as signed JSON.

A gateway between robots and a web page does not speak DDS Security, but must know who may do what. This build type
gives it a JSON document of the rules and an S/MIME signature by the permissions authority.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from keymint.api import Artifact, BuildOptions, Built, Credentials, Inspection, Package
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.pki import smime

DOCUMENT = "access.json"
SIGNED = "access.json.p7s"


class JsonBuildType:
    """Implements :class:`keymint.api.BuildType`."""

    API = "1.0"

    def build(self, package: Package, options: BuildOptions) -> Built:
        """Return the rules as JSON; the same rules give the same bytes."""
        del options  # nothing here is vendor-specific
        rules = [
            {
                "effect": str(rule.effect),
                "kind": rule.kind,
                "permissions": sorted(rule.permissions),
                "expressions": sorted(rule.expressions),
                "partitions": sorted(rule.partitions),
            }
            for rule in package.permissions.rules.rules
        ]
        document = {
            "subject": package.subject,
            "not_before": package.permissions.validity.not_before.isoformat(),
            "not_after": package.permissions.validity.not_after.isoformat(),
            "rules": sorted(rules, key=lambda rule: json.dumps(rule, sort_keys=True)),
        }
        return Built({DOCUMENT: (json.dumps(document, indent=2, sort_keys=True) + "\n").encode()})

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: Credentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """Return the files of the enclave; a signature over unchanged content is kept."""
        del layout
        content = documents.get(DOCUMENT, b"")
        try:
            json.loads(content)
        except ValueError as error:
            raise KeymintError(
                f"{DOCUMENT} of {package.name} is not JSON: {error}", help=f"keymint build -f {package.name}"
            ) from error
        signer = smime.load_signer(credentials.signer)
        signed = installed.get(SIGNED)
        if signed is None or not smime.is_current(signed, content, signer.certificate):
            signed = smime.sign(content, signer.certificate, signer.key)
        return {
            SIGNED: Artifact(signed),
            "identity_ca.cert.pem": Artifact(credentials.identity_ca),
            "permissions_ca.cert.pem": Artifact(credentials.permissions_ca),
            "key.pem": Artifact(credentials.key, secret=True),
            "cert.pem": Artifact(credentials.certificate),
        }

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        """Return nothing: every enclave is complete in itself."""
        del artifacts, layout
        return {}

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """Return a finding when the signature does not hold, or the rules are not those of the sources."""
        where = Origin(f"{inspection.folder}/{SIGNED}")
        signed = inspection.files.get(SIGNED)
        if signed is None:
            return [Diagnostic("file-missing", Severity.ERROR, "is missing", where, "keymint install")]
        try:
            content = smime.verify(signed, inspection.permissions_ca, at=inspection.now, where=where)
        except KeymintError as error:
            return error.diagnostics
        if content != inspection.documents[DOCUMENT]:
            return [Diagnostic("drift", Severity.ERROR, "is not what the sources build", where, "keymint build")]
        return []

    def check_all(self, inspections: Sequence[Inspection]) -> Sequence[Diagnostic]:
        """Return nothing: no finding concerns several enclaves."""
        del inspections
        return []


build_type = JsonBuildType()
