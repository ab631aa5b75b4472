# SPDX-License-Identifier: Apache-2.0
"""A build type in a separate package: access rules as signed JSON.

A gateway between robots and a web page does not speak DDS Security, but must know who may do what. This build type
produces a JSON document of the rules, an S/MIME signature over it by the permissions authority, and the identity's key
and certificate.

A plugin takes all its input as arguments and returns bytes: it never writes files, and never reads the clock or the
environment.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from comarmor.errors import Diagnostic, Origin
from comarmor.rules import PERMISSIONS
from keymint.api import (
    Artifact,
    AuthorityRole,
    BuildOptions,
    BuildResult,
    BuildType,
    Credentials,
    Inspection,
    Layout,
    Package,
)
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime
from keymint.pki.examine import verify_chain

DOCUMENT = "access.json"
SIGNED = "access.json.p7s"
CERTIFICATE = "cert.pem"
KEY = "key.pem"
IDENTITY_CA = "identity_ca.cert.pem"
PERMISSIONS_CA = "permissions_ca.cert.pem"
IDENTITY, RIGHTS = "identity", "rights"
"""Roles of the two authorities."""
FILES = (SIGNED, CERTIFICATE, KEY, IDENTITY_CA, PERMISSIONS_CA)


class JsonBuildType(BuildType):
    """Builds, signs and checks the rules of a package as JSON."""

    API = "3.0"
    TRANSPORT = "json"
    LAYOUTS: Mapping[str, Layout] = {"sros2": Layout("enclaves"), "flat": Layout("")}
    READS: tuple[str, ...] = (".pem", ".p7s")
    KINDS: tuple[str, ...] = tuple(PERMISSIONS)

    def files(self, layout: str) -> frozenset[str]:
        """Return the names of the files of an enclave."""
        del layout  # a gateway's enclave is the same in every layout
        return frozenset(FILES)

    def authorities(self, package: Package) -> Sequence[AuthorityRole]:
        """Return the issuer of the identity, and the authority that signs the document."""
        return (
            AuthorityRole(IDENTITY, package.identity.issuer, package.identity.origin),
            AuthorityRole(RIGHTS, package.grant.issuer, package.grant.origin, signs=True),
        )

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        """Return the rules as JSON: the same bytes for the same rules, whatever their order in the policy."""
        del options  # JSON can express every rule, so the options for lenient builds do not apply
        grant = package.grant
        rules: list[dict[str, Any]] = [
            {
                "effect": str(rule.effect),
                "kind": rule.kind,
                "permissions": sorted(rule.permissions),
                "expressions": sorted(rule.expressions),
                "partitions": sorted(rule.partitions),
            }
            for rule in grant.rules.rules
        ]
        document: dict[str, Any] = {
            "subject": package.subject,
            "domains": [[domains.first, domains.last] for domains in sorted(grant.domains)],
            "rules": sorted(rules, key=lambda rule: json.dumps(rule, sort_keys=True)),
        }
        if grant.validity is not None:
            document["not_before"] = grant.validity.not_before.isoformat()
            document["not_after"] = grant.validity.not_after.isoformat()
        return BuildResult({DOCUMENT: (json.dumps(document, indent=2, sort_keys=True) + "\n").encode()})

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: Credentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """Return the files of the enclave; keep the signature of unchanged content.

        Raises:
            KeymintError: the document (which may be edited by hand) is missing or not JSON.
        """
        del layout  # a gateway's enclave is the same in every layout
        content = documents.get(DOCUMENT, b"")
        try:
            json.loads(content)
        except ValueError as error:
            raise KeymintError(
                f"is not JSON: {error}",
                where=Origin(f"{package.name}/{DOCUMENT}"),
                help=f"'keymint build -f {package.name}' rewrites it",
                code="document-invalid",
            ) from error
        signer = smime.load_signer(credentials.signers[RIGHTS])
        signed = installed.get(SIGNED)
        if signed is None or not smime.is_current(signed, content, signer.certificate):
            signed = smime.sign(content, signer.certificate, signer.key)
        return {
            SIGNED: Artifact(signed),
            CERTIFICATE: Artifact(credentials.certificate),
            KEY: Artifact(credentials.key, secret=True),
            IDENTITY_CA: Artifact(credentials.chains[IDENTITY]),
            PERMISSIONS_CA: Artifact(credentials.chains[RIGHTS]),
        }

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """Return the defects of an installed enclave, and where it differs from what its sources build.

        Keymint itself checks file modes, and whether files changed since they were installed.
        """
        return tuple(_findings(inspection))


def _findings(inspection: Inspection) -> Iterator[Diagnostic]:
    missing = [name for name in FILES if name not in inspection.files]
    if missing:
        yield from (_error(inspection, "file-missing", name, "is missing") for name in missing)
        return
    yield from _altered_files(inspection)
    where = _where(inspection, CERTIFICATE)
    yield from verify_chain(inspection.files[CERTIFICATE], inspection.chains[IDENTITY], inspection.now, where)
    try:
        yield from _inconsistencies(inspection)
    except KeymintError as error:
        yield from error.diagnostics


def _altered_files(inspection: Inspection) -> Iterator[Diagnostic]:
    """Check the files whose bytes are known or canonical."""
    files = inspection.files
    for name, trusted in ((IDENTITY_CA, inspection.chains[IDENTITY]), (PERMISSIONS_CA, inspection.chains[RIGHTS])):
        if files[name] != trusted:
            yield _error(inspection, "authority-differs", name, "is not the certificate of the workspace's authority")
    for name, is_canonical in ((CERTIFICATE, certificates.is_canonical), (KEY, keys.is_canonical)):
        if not is_canonical(files[name]):
            yield _error(inspection, "pem-altered", name, "is not the canonical PEM encoding of its content")


def _inconsistencies(inspection: Inspection) -> Iterator[Diagnostic]:
    """Check files against each other.

    Raises:
        KeymintError: a file cannot be read, or the signature is invalid.
    """
    files = inspection.files
    where = _where(inspection, SIGNED)
    content = smime.verify(files[SIGNED], inspection.chains[RIGHTS], at=inspection.now, where=where)
    if content != inspection.documents[DOCUMENT]:
        yield _error(inspection, "drift", SIGNED, "signs other content than the sources build")
    if inspection.package.identity.key.password_env:
        return  # the key cannot be read without its password
    key = keys.from_pem(files[KEY], where=_where(inspection, KEY))
    if not keys.matches(key, certificates.load(files[CERTIFICATE], _where(inspection, CERTIFICATE))):
        yield _error(inspection, "key-mismatch", KEY, f"is not the key of {CERTIFICATE}")


def _where(inspection: Inspection, name: str) -> Origin:
    return Origin(f"{inspection.folder}/{name}")


def _error(inspection: Inspection, code: str, name: str, message: str) -> Diagnostic:
    fix = f"'keymint install {inspection.package.name}' rewrites it"
    return Diagnostic.error(code, message, _where(inspection, name), fix, inspection.package.subject)


build_type = JsonBuildType()
