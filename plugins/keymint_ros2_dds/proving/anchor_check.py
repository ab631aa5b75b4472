"""Compare the trust anchors of an enclave with the authorities of the workspace.

Vendors trust the authorities in the enclave. An enclave of someone else is consistent in itself, so only a comparison
with the workspace detects it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import lru_cache

from cryptography import x509

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import TrustAnchor, TrustAnchors
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, names, smime, verify
from keymint_ros2_dds import revocation
from keymint_ros2_dds.enclave_layout import (
    CA,
    CERTIFICATE,
    CRL,
    FILES,
    GOVERNANCE_P7S,
    IDENTITY_CA,
    KEY,
    PERMISSIONS_CA,
    PERMISSIONS_P7S,
)

IN_PLACE_OF = {f"{name.removesuffix('.pem')}.p11": name for name in (IDENTITY_CA, PERMISSIONS_CA, CERTIFICATE, KEY)}
"""A file with a PKCS #11 URI that ROS 2 reads in place of another one, where the vendor takes such URIs.

Source: ``get_security_files`` in ``security.cpp`` of rmw_dds_common, from Jazzy on, as rmw_fastrtps calls it.
"""
_ANY_TIME = datetime(2000, 1, 1, tzinfo=UTC)
_TIMES = frozenset(("certificate-expired", "certificate-not-yet-valid"))
"""Findings about time; they do not concern trust."""


def differences(files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> tuple[Diagnostic, ...]:
    """Return what is not issued by the workspace's authorities; see :meth:`keymint.api.Prover.differences`."""
    missing = tuple(_missing(anchors))
    return missing or tuple(_AnchorCheck(files, folder, anchors).found())


def _missing(anchors: TrustAnchors) -> Iterator[Diagnostic]:
    for anchor in dict.fromkeys((anchors.identity, anchors.permissions)):
        if not anchor.chain:
            message = (
                f"the certificate of the authority {anchor.name!r} is missing: nothing says whom enclaves may trust"
            )
            help_ = "restore it from a copy of the workspace; that in the enclave vouches for nothing"
            yield Diagnostic("authority-missing", Severity.ERROR, message, Origin(anchor.file), help_)
            continue
        try:
            certificates.load_bundle(anchor.chain, Origin(anchor.file))
        except KeymintError as error:
            yield from error.diagnostics


class _AnchorCheck:
    """Checks the files of one enclave."""

    def __init__(self, files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> None:
        self._files = files
        self._folder = folder
        self._anchors = anchors

    def found(self) -> Iterator[Diagnostic]:
        yield from self._in_place_of()
        yield from self._revocations()
        yield from self._authorities()
        yield from self._identity()
        yield from self._signed(PERMISSIONS_P7S)
        yield from self._signed(GOVERNANCE_P7S)

    def _where(self, name: str) -> Origin:
        return Origin(f"{self._folder}/{name}")

    def _error(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        return Diagnostic(code, Severity.ERROR, message, self._where(name), help_)

    def _file(self, name: str) -> bytes:
        """Return a file.

        Raises:
            KeymintError: it is missing.
        """
        content = self._files.get(name)
        if content is None:
            raise KeymintError(
                "is missing", where=self._where(name), help="'keymint install' restores it", code="file-missing"
            )
        return content

    def _in_place_of(self) -> Iterator[Diagnostic]:
        for name in sorted(self._files.keys() & IN_PLACE_OF.keys()):
            message = f"is read in place of {IN_PLACE_OF[name]} by ROS 2 from Jazzy on: what it refers to is not known"
            yield self._error("file-replaced", name, message, "remove it")

    def _revocations(self) -> Iterator[Diagnostic]:
        """Check a revocation list: vendors refuse participants if it is not the authority's, or revokes them."""
        pem = self._files.get(CRL)
        if pem is None:
            return
        problem = revocation.problem(pem, self._files.get(CERTIFICATE, b""), self._anchors.identity.chain)
        if problem:
            help_ = f"remove it, or write a list of the authority {self._anchors.identity.name!r}"
            yield self._error("revocation-list", CRL, problem, help_)

    def _authorities(self) -> Iterator[Diagnostic]:
        """Compare the authorities in the enclave, including files that its layout does not have."""
        wanted: Mapping[str, TrustAnchor] = {
            IDENTITY_CA: self._anchors.identity,
            PERMISSIONS_CA: self._anchors.permissions,
            CA: self._anchors.permissions,
        }
        for name, anchor in wanted.items():
            content = self._files.get(name)
            if content is None and name in FILES.get(self._anchors.layout, ()):
                yield self._error("file-missing", name, "is missing", "'keymint install' restores it")
            elif content is not None and content != anchor.chain:
                message = f"is not the certificate of the workspace's authority {anchor.name!r}, {anchor.file}"
                help_ = "the enclave trusts someone else: find out who wrote it, then 'keymint install' restores it"
                yield self._error("authority-differs", name, message, help_)

    def _identity(self) -> Iterator[Diagnostic]:
        where = self._where(CERTIFICATE)
        try:
            pem = self._file(CERTIFICATE)
            certificate = certificates.load(pem, where)
            wanted = names.parse(self._anchors.subject_name)
        except KeymintError as error:
            yield from error.diagnostics
            return
        found = verify.verify_chain(pem, self._anchors.identity.chain, _ANY_TIME, where)
        yield from (each for each in found if each.code not in _TIMES)
        if certificate.subject != wanted:
            message = f"is for {names.to_text(certificate.subject)!r}, not {names.to_text(wanted)!r}"
            yield self._error("certificate-subject", CERTIFICATE, message, "'keymint install' restores it")
        yield from self._key(certificate)

    def _key(self, certificate: x509.Certificate) -> Iterator[Diagnostic]:
        pem = self._files.get(KEY)
        if pem is None:
            return  # the key may be kept elsewhere
        try:
            key = keys.from_pem(pem, None, self._where(KEY))
        except KeymintError as error:
            # An encrypted key cannot be read without its password, and nothing is claimed of it.
            yield from (each for each in error.diagnostics if each.code != "key-password")
            return
        if not keys.matches(key, certificate):
            message = "is not the key of the certificate beside it"
            yield self._error("key-mismatch", KEY, message, "'keymint install' restores it")

    def _signed(self, name: str) -> Iterator[Diagnostic]:
        try:
            found = _refused(self._file(name), self._anchors.permissions.chain)
        except KeymintError as error:
            found = error.diagnostics
        for each in found:
            line = each.where.line if each.where else 0
            yield replace(each, where=Origin(f"{self._folder}/{name}", line))


# Enclaves usually have the same governance.
@lru_cache(maxsize=64)
def _refused(document: bytes, authority: bytes) -> tuple[Diagnostic, ...]:
    try:
        smime.read(document, authority, where=Origin("a signed document"))
    except KeymintError as error:
        return error.diagnostics
    return ()
