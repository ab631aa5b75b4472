# SPDX-License-Identifier: Apache-2.0
"""Checks of the identity in an enclave: its certificate, its key, and the authority that it trusts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cached_property, lru_cache

from cryptography import x509

from comarmor.errors import Defects, Diagnostic, Origin
from keymint.api import TrustAnchor, TrustAnchors, ValidityTerm
from keymint.errors import KeymintError
from keymint.names import name_of
from keymint.pki import certificates, certification_path, distinguished_names, keys, public_keys
from keymint.pki.distinguished_names import to_text

CERTIFICATE, KEY = "cert.pem", "key.pem"
When = tuple[datetime, timedelta]
"""The clock, UTC, and within which time an end is reported."""


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
        self._renew = f"keymint renew {name_of(subject)}"

    @cached_property
    def certificate(self) -> x509.Certificate | None:
        """The identity certificate; None if it is missing or damaged, which is reported with its path."""
        return certificates.certificate_in(self._files.get(CERTIFICATE))

    def _where(self, name: str) -> Origin:
        return Origin(f"{self._folder}/{name}")

    def _error(self, code: str, name: str, message: str, help_: str = "") -> Diagnostic:
        """Return an error about a file; by default ``keymint install`` fixes it."""
        return Diagnostic.error(code, message, self._where(name), help_ or self._restore, self._subject)

    def _warning(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        """Return a warning about a file."""
        return Diagnostic.warning(code, message, self._where(name), help_, self._subject)

    @cached_property
    def own_key(self) -> tuple[keys.PublicKey | None, tuple[Diagnostic, ...]]:
        """The public half of the private key in the enclave, if it has one, and why that cannot be read."""
        pem, unread = self._files.get(KEY), Defects()
        own = None if pem is None else unread.attempt(lambda: keys.public_of(pem, None, self._where(KEY)))
        return own, tuple(map(self._for_subject, unread.found))

    def inventory(self, needed: Iterable[str]) -> Iterator[Diagnostic]:
        """Yield an error for each file that is not there."""
        for name in needed:
            if name not in self._files:
                yield self._error("file-missing", name, "is missing")

    def anchored(self, name: str, anchor: TrustAnchor) -> Iterator[Diagnostic]:
        """Check that a file, if it is there, has the authority that the enclave must trust."""
        if self._files.get(name, anchor.chain) != anchor.chain:
            message = f"is not the certificate of the authority {anchor.name!r}, {anchor.file}"
            help_ = "the enclave trusts another authority: find out who wrote it before 'keymint install' restores it"
            yield self._error("authority-differs", name, message, help_)

    def identity(self, authorities: bytes, anchors: TrustAnchors) -> Iterator[Diagnostic]:
        """Check the certificate, if it is there, and its key.

        Args:
            authorities: the authorities that the certificate must chain to, PEM.
            anchors: what the enclave must rest on; its certificate may have any name if they have none.
        """
        pem, where = self._files.get(CERTIFICATE), self._where(CERTIFICATE)
        if pem is None:
            return
        try:
            certificate = certificates.load(pem, where)
            certificates.public_key(certificate, where)
            name = anchors.subject_name
            expected = distinguished_names.parse(name) if name else certificate.subject
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
            return
        if authorities:  # else their file is missing, which is reported
            yield from map(self._for_subject, certification_path.verify_chain(pem, authorities, None, where))
        if certificate.subject != expected:
            message = f"is for {to_text(certificate.subject)!r}, not {to_text(expected)!r}"
            yield self._error("certificate-subject", CERTIFICATE, message)
        yield from self._key(certificate, anchors.public_key)

    def _for_subject(self, diagnostic: Diagnostic) -> Diagnostic:
        return replace(diagnostic, where=diagnostic.where or self._where(""), subject=self._subject)

    def _key(self, certificate: x509.Certificate, public_key: bytes) -> Iterator[Diagnostic]:
        """Check that the key, if the enclave has one, is that of its certificate.

        Args:
            certificate: the identity certificate.
            public_key: the key that it must be for (PEM), if the private key is elsewhere; empty if it may be for any.
        """
        if public_key and public_keys.from_pem(public_key) != certificate.public_key():
            yield self._error("key-mismatch", CERTIFICATE, "is for another public key than the package has")
        own, unread = self.own_key
        yield from unread
        if own is not None and not keys.matches(own, certificate):
            yield self._error("key-mismatch", KEY, "is not the key of the certificate beside it")

    # -- dates ---------------------------------------------------------------------------------------------------

    def certificate_period(self, when: When, at_the_end: str = "") -> Iterator[Diagnostic]:
        """Yield the finding on the dates of the certificate; arguments as for :meth:`_period`."""
        if self.certificate is not None:
            period = certificates.period(self.certificate)
            yield from self._period("certificate", CERTIFICATE, period, when, self._renew, at_the_end)

    def _period(
        self, what: str, name: str, period: tuple[datetime, datetime], when: When, again: str, at_the_end: str = ""
    ) -> Iterator[Diagnostic]:
        """Yield the finding on dates that are over, are to come, or end soon; both ends of a period count.

        Args:
            what: what has them; with hyphens, the begin of the codes.
            name: its file.
            period: the dates, UTC.
            when: the clock, and within which time an end is reported.
            again: the command that issues it again.
            at_the_end: what happens then.
        """
        (now, within), (begin, end), code = when, period, what.replace(" ", "-")
        renew = f"'{again}' issues it again, with later dates"
        if now > end:
            yield self._error(f"{code}-expired", name, f"the {what} expired on {utc_time(end)}", renew)
        elif now < begin:
            help_ = f"compare the clock of this machine; if it is right, '{again}' issues it again"
            yield self._error(f"{code}-not-yet-valid", name, f"the {what} is not valid before {utc_time(begin)}", help_)
        elif now + within >= end:
            message = f"the {what} expires on {utc_time(end)}" + (at_the_end and f"; {at_the_end}")
            yield self._warning(f"{code}-expires", name, message, renew)


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


def utc_time(moment: datetime) -> str:
    """Return a moment for messages."""
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"
