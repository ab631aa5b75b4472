# SPDX-License-Identifier: Apache-2.0
"""Checks of the identity in an enclave: its certificate, its key, and the authority that it trusts."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import datetime
from functools import lru_cache

from cryptography import x509

from comarmor.errors import Defects, Diagnostic, Origin
from keymint.api import TrustAnchor, ValidityTerm
from keymint.errors import KeymintError
from keymint.pki import certificates, certification_path, distinguished_names, keys, public_keys
from keymint.pki.distinguished_names import to_text

CERTIFICATE, KEY = "cert.pem", "key.pem"


class IdentityCheck:
    """Checks of one enclave that ``keymint check`` and ``keymint prove`` share.

    Args:
        files: the enclave's files by name.
        folder: its folder as the user would type it.
        restore: help for a file that ``keymint install`` restores.
        subject: the subject of the findings, if they name it.
    """

    def __init__(self, files: Mapping[str, bytes], folder: str, restore: str, subject: str = "") -> None:
        self._files = files
        self._folder = folder
        self._restore = restore
        self._subject = subject

    def _where(self, name: str) -> Origin:
        return Origin(f"{self._folder}/{name}")

    def _error(self, code: str, name: str, message: str, help_: str = "") -> Diagnostic:
        """Return an error about a file; by default ``keymint install`` fixes it."""
        return Diagnostic.error(code, message, self._where(name), help_ or self._restore, self._subject)

    def _warning(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        """Return a warning about a file."""
        return Diagnostic.warning(code, message, self._where(name), help_, self._subject)

    def _anchored(self, name: str, anchor: TrustAnchor) -> Iterator[Diagnostic]:
        """Check that a file has the authority that the enclave must trust."""
        if self._files[name] != anchor.chain:
            message = f"is not the certificate of the authority {anchor.name!r}, {anchor.file}"
            help_ = "the enclave trusts another authority: find out who wrote it before 'keymint install' restores it"
            yield self._error("authority-differs", name, message, help_)

    def _for_subject(self, diagnostic: Diagnostic) -> Diagnostic:
        return replace(diagnostic, where=diagnostic.where or self._where(""), subject=self._subject)

    def _certificate(
        self, authorities: bytes, subject_name: str, at: datetime | None
    ) -> Generator[Diagnostic, None, x509.Certificate | None]:
        """Check the path and the name of the certificate, which is there; the generator returns it if it can be read.

        Args:
            authorities: the authorities that it must chain to, PEM.
            subject_name: the distinguished name that it must have; empty if it may have any.
            at: see :func:`keymint.pki.certification_path.verify_chain`.
        """
        pem, where = self._files[CERTIFICATE], self._where(CERTIFICATE)
        try:
            certificate = certificates.load(pem, where)
            certificates.public_key(certificate, where)
            expected = distinguished_names.parse(subject_name) if subject_name else certificate.subject
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
            return None
        if authorities:  # else their file is missing, which is reported
            yield from map(self._for_subject, certification_path.verify_chain(pem, authorities, at, where))
        if certificate.subject != expected:
            message = f"is for {to_text(certificate.subject)!r}, not {to_text(expected)!r}"
            yield self._error("certificate-subject", CERTIFICATE, message)
        return certificate

    def _key(self, certificate: x509.Certificate, public_key: bytes = b"") -> Iterator[Diagnostic]:
        """Check that the key, if the enclave has one, is that of its certificate.

        Args:
            certificate: the identity certificate.
            public_key: the key that it must be for (PEM), if the private key is elsewhere; empty if it may be for any.
        """
        if public_key and public_keys.from_pem(public_key) != certificate.public_key():
            yield self._error("key-mismatch", CERTIFICATE, "is for another public key than the package has")
        pem = self._files.get(KEY)
        if pem is None:
            return
        unread = Defects()
        own = unread.attempt(lambda: keys.public_of(pem, None, self._where(KEY)))
        yield from map(self._for_subject, unread.found)
        if own is not None and not keys.matches(own, certificate):
            yield self._error("key-mismatch", KEY, "is not the key of the certificate beside it")


def anchor_defects(anchors: Iterable[TrustAnchor]) -> Iterator[Diagnostic]:
    """Yield an error for each authority whose certificate the workspace lacks, or cannot read."""
    for anchor in dict.fromkeys(anchors):
        if not anchor.chain:
            message = f"the certificate of the authority {anchor.name!r} is missing, so nothing can be compared with it"
            help_ = "restore it from a backup of the workspace; the copy in the enclave proves nothing"
            yield Diagnostic.error("authority-missing", message, Origin(anchor.file), help_)
            continue
        try:
            certificates.load_bundle(anchor.chain, Origin(anchor.file))
        except KeymintError as error:
            yield from error.diagnostics


def enclave_file(files: Mapping[str, bytes], folder: str, name: str) -> bytes:
    """Return a file of an enclave.

    Raises:
        KeymintError: the enclave lacks it.
    """
    if name not in files:
        where = Origin(f"{folder}/{name}")
        raise KeymintError("is missing", where=where, help="'keymint install' restores it", code="file-missing")
    return files[name]


def certificate_terms(files: Mapping[str, bytes], folder: str, names: Iterable[str]) -> Iterator[ValidityTerm]:
    """Yield a term for each certificate in some files of an enclave.

    Raises:
        KeymintError: a file is missing, or contains no certificate.
    """
    for name in names:
        content, where = enclave_file(files, folder, name), Origin(f"{folder}/{name}")
        code = "certificate" if name == CERTIFICATE else "authority"
        try:
            periods = _periods(content)
        except KeymintError as error:
            raise error.at(where) from None
        for subject, period in periods:
            yield ValidityTerm(code, f"the certificate of {subject!r}", where, (period,))


# Enclaves usually have the same authorities.
@lru_cache(maxsize=64)
def _periods(pem: bytes) -> tuple[tuple[str, tuple[datetime, datetime]], ...]:
    return tuple((to_text(each.subject), certificates.period(each)) for each in certificates.load_bundle(pem))
