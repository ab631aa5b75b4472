# SPDX-License-Identifier: Apache-2.0
"""Compare the trust anchors of an enclave with the authorities of the workspace.

Vendors trust the authorities in the enclave. If someone else issued all its files, they are consistent with each
other, so only a comparison with the workspace detects it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from comarmor.errors import Diagnostic
from keymint.api import TrustAnchors
from keymint.errors import KeymintError
from keymint.pki import smime
from keymint.pki.identity_check import anchor_defects, enclave_file
from keymint_ros2_dds import authority_roles as roles
from keymint_ros2_dds import token_key
from keymint_ros2_dds.credentials import CredentialCheck
from keymint_ros2_dds.enclave_layout import (
    CA,
    CERTIFICATE,
    GOVERNANCE_P7S,
    IDENTITY_CA,
    KEY,
    KEY_URI,
    PERMISSIONS_CA,
    PERMISSIONS_P7S,
    enclave_files,
)

IN_PLACE_OF = {f"{name.removesuffix('.pem')}.p11": name for name in (IDENTITY_CA, PERMISSIONS_CA, CERTIFICATE, KEY)}
"""A file with a PKCS #11 URI that ROS 2 reads in place of another one, where the vendor takes such URIs.

Source: ``get_security_files`` in ``security.cpp`` of rmw_dds_common, from Jazzy on, as rmw_fastrtps calls it.
"""


def differences(
    files: Mapping[str, bytes],
    folder: str,
    anchors: TrustAnchors,
    shared: Mapping[str, bytes] | None = None,
    shared_folder: str = "",
) -> tuple[Diagnostic, ...]:
    """See :meth:`keymint.api.Prover.differences`."""
    del shared, shared_folder  # an enclave is complete
    missing = tuple(anchor_defects(anchors.authorities[role] for role in (roles.IDENTITY, roles.PERMISSIONS)))
    return missing or tuple(_AnchorCheck(files, folder, anchors).findings())


class _AnchorCheck(CredentialCheck):
    """Checks the files of one enclave."""

    def __init__(self, files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> None:
        super().__init__(files, folder, "'keymint install' restores it")
        self._anchors = anchors
        self._issuer, self._signer = (anchors.authorities[role] for role in (roles.IDENTITY, roles.PERMISSIONS))

    def findings(self) -> Iterator[Diagnostic]:
        yield from self._in_place_of()
        help_ = f"remove it, or replace it with a list signed by the authority {self._issuer.name!r}"
        yield from self._revocation_list(self._issuer.chain, help_)
        yield from self._authorities()
        yield from self._identity()
        yield from self._signed(PERMISSIONS_P7S)
        yield from self._signed(GOVERNANCE_P7S)

    def _in_place_of(self) -> Iterator[Diagnostic]:
        known = {KEY_URI} if token_key.is_uri(self._files.get(KEY_URI), self._anchors.key_uri) else set()
        for name in sorted(self._files.keys() & IN_PLACE_OF.keys() - known):
            message = (
                f"replaces {IN_PLACE_OF[name]} in ROS 2 Jazzy and later, and Keymint cannot check what it refers to"
            )
            yield self._error("file-replaced", name, message, "remove it")

    def _authorities(self) -> Iterator[Diagnostic]:
        """Compare the authorities in the enclave, including files that its layout does not have."""
        needed = enclave_files(self._anchors.layout, self._anchors.distro)
        for name, anchor in ((IDENTITY_CA, self._issuer), (PERMISSIONS_CA, self._signer), (CA, self._signer)):
            if name in self._files:
                yield from self._anchored(name, anchor)
            elif name in needed:
                yield self._error("file-missing", name, "is missing")

    def _identity(self) -> Iterator[Diagnostic]:
        if CERTIFICATE not in self._files:
            yield self._error("file-missing", CERTIFICATE, "is missing")
            return
        certificate = yield from self._certificate(self._issuer.chain, self._anchors.subject_name, None)
        if certificate is not None:
            # An encrypted key cannot be read without its password, so it is not compared with the certificate.
            of_key = self._key(certificate, self._anchors.public_key)
            yield from (finding for finding in of_key if finding.code != "key-password")
        if KEY not in self._files and not self._anchors.public_key and not self._anchors.key_uri:
            yield self._error("file-missing", KEY, "is missing")

    def _signed(self, name: str) -> Iterator[Diagnostic]:
        try:
            content = enclave_file(self._files, self._folder, name)
            smime.read(content, self._signer.chain, where=self._where(name))
        except KeymintError as error:
            yield from error.diagnostics
