# SPDX-License-Identifier: Apache-2.0
"""The install stage: signs the documents of a package and returns the files of its enclave."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache

from keymint import api
from keymint.api import Artifact, Credentials, Package
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, smime
from keymint_ros2_dds import enclave_layout as enclave
from keymint_ros2_dds.documents import dds_xml


def install(
    package: Package,
    documents: Mapping[str, bytes],
    credentials: Credentials,
    layout: str,
    installed: Mapping[str, bytes],
) -> Mapping[str, Artifact]:
    """Return the files of an enclave by name; see :meth:`keymint.api.BuildType.install`.

    Raises:
        KeymintError: a document is missing or not valid, or the layout has no place for two authorities.
    """
    if layout not in enclave.LAYOUTS:
        help_ = f"use {' or '.join(enclave.LAYOUTS)}"
        raise KeymintError(f"unknown layout {layout!r}", help=help_, code="layout-unknown")
    issuers, signers = (credentials.chains[role] for role in (enclave.IDENTITY_ROLE, enclave.PERMISSIONS_ROLE))
    if enclave.has_one_authority(layout, package.distro) and issuers != signers:
        message = (
            f"{package.subject} has one authority for identities and another for permissions, but the layout 'flat' "
            f"has one file for both in {package.distro.capitalize()}"
        )
        help_ = "name one authority for both, or use the layout 'sros2'"
        raise KeymintError(message, where=package.grant.origin, help=help_, code="layout-authorities")
    permissions = _document(package, documents, enclave.PERMISSIONS)
    governance = _document(package, documents, enclave.GOVERNANCE)
    files = {
        enclave.IDENTITY_CA: Artifact(issuers),
        enclave.PERMISSIONS_CA: Artifact(signers),
        enclave.CA: Artifact(signers),
        enclave.CERTIFICATE: Artifact(credentials.certificate),
        enclave.KEY: Artifact(credentials.key, secret=True),
        enclave.PERMISSIONS_XML: Artifact(permissions),
        enclave.PERMISSIONS_P7S: Artifact(_signed(permissions, enclave.PERMISSIONS, credentials, installed)),
        enclave.GOVERNANCE_P7S: Artifact(_signed(governance, enclave.GOVERNANCE, credentials, installed)),
    }
    needed = enclave.enclave_files(layout, package.distro)
    chosen = {name: files[name] for name in needed if name != enclave.KEY or credentials.key}
    if uri := package.identity.key.uri:  # ROS 2 reads one word; the end of the line is for people
        chosen[enclave.KEY_URI] = Artifact(f"{uri}\n".encode())
    if credentials.revocations:
        chosen |= revocation_files(package.distro, layout, credentials.revocations)
    return chosen


def revocation_files(distro: str, layout: str, revocations: bytes) -> Mapping[str, Artifact]:
    """Return the file of a revocation list; see :meth:`keymint.api.BuildType.revocation_files`."""
    return {enclave.CRL: Artifact(revocations)} if enclave.reads_revocations(distro, layout) else {}


def _document(package: Package, documents: Mapping[str, bytes], kind: str) -> bytes:
    content, where = documents.get(f"{kind}.xml"), Origin(f"{package.name}/{kind}.xml")
    if content is None:
        message, help_ = f"{package.subject} has no {kind}.xml", f"run 'keymint build {package.name}'"
        raise KeymintError(message, where=where, help=help_, code="document-missing")
    dds_xml.require_valid(content, kind, where.file)
    smime.require_signable(content, where)
    return content


def _signed(content: bytes, kind: str, credentials: Credentials, installed: Mapping[str, bytes]) -> bytes:
    """Return a signed document: the installed one if it is still current, else a new one."""
    present = installed.get(f"{kind}.p7s")
    in_force = certificates.load_bundle(credentials.chains[enclave.PERMISSIONS_ROLE])[0]
    if present is not None and smime.is_current(present, content, in_force):
        return present
    sign = _sign_once if kind == enclave.GOVERNANCE else _sign
    return sign(content, credentials.signers[enclave.PERMISSIONS_ROLE])  # whose key may be elsewhere


def _sign(content: bytes, authority: api.SigningAuthority) -> bytes:
    signer = smime.load_signer(authority)
    return smime.sign(content, signer.certificate, signer.key)


_sign_once = lru_cache(maxsize=16)(_sign)
"""Signs a document that many enclaves share."""


def shared_files(artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
    """Return the files that the layout keeps once for all enclaves, by path relative to the install space.

    They are a convenience for people and for sros2's tools; enclaves are complete without them. So a file is omitted if
    the enclaves do not agree on it (an authority, the governance).

    Args:
        artifacts: artifacts by subject, then file name; enclaves of other build types are ignored.
        layout: ``sros2`` or ``flat``; the latter keeps nothing.
    """
    enclaves = [files for _, files in sorted(artifacts.items()) if enclave.GOVERNANCE_P7S in files]
    if layout != "sros2" or not enclaves:
        return {}
    result: dict[str, Artifact] = {}
    for name in (enclave.IDENTITY_CA, enclave.PERMISSIONS_CA):
        contents = {files[name].content for files in enclaves if name in files}
        if len(contents) == 1:
            result[f"public/{name}"] = Artifact(contents.pop())
    if len(result) == 2 and len({artifact.content for artifact in result.values()}) == 1:  # noqa: PLR2004 - both
        result[f"public/{enclave.CA}"] = result[f"public/{enclave.IDENTITY_CA}"]
    signed = [files[enclave.GOVERNANCE_P7S].content for files in enclaves]
    with suppress(KeymintError):  # one cannot be read
        documents = set(map(smime.signed_content, dict.fromkeys(signed)))
        if len(documents) == 1:
            result[f"enclaves/{enclave.GOVERNANCE_XML}"] = Artifact(documents.pop())
            result[f"enclaves/{enclave.GOVERNANCE_P7S}"] = Artifact(signed[0])
    return result
