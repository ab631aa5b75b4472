# SPDX-License-Identifier: Apache-2.0
"""Judge the identity in an enclave: its certificate, its key, the authority that it trusts, and the path between them.

A certification path leads from a certificate to a self-signed authority (RFC 5280, section 6).
``cryptography.x509.verification`` is for the web: it requires a subjectAltName. :func:`verify_chain` checks each link:
name chaining, signature, basicConstraints, path length, keyUsage, validity and unknown critical extensions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import cached_property, lru_cache

from cryptography import x509

from comarmor.values import replace
from keymint.api import TrustAnchor, TrustAnchors, ValidityTerm
from keymint.errors import Defects, Diagnostic, KeymintError, Origin
from keymint.names import name_of
from keymint.pki import certificates, distinguished_names, extensions, keys, periods
from keymint.pki.distinguished_names import to_text

CERTIFICATE, KEY = "cert.pem", "key.pem"
When = tuple[datetime, timedelta]
"""The clock, UTC, and within which time an end is reported."""
_UNDERSTOOD = (
    x509.BasicConstraints,
    x509.KeyUsage,
    x509.ExtendedKeyUsage,
    x509.SubjectAlternativeName,
    x509.CertificatePolicies,
)
"""Extensions that may be critical: they are checked here, or do not restrict what a keystore needs."""
_MAX_PATH = 16
"""Maximum certificates of a path; transports accept one authority, or a few."""


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
            name, subject = anchors.subject_name, certificate.subject
            is_for = not name or distinguished_names.written_name(name).encoded == subject.public_bytes()
            expected = subject if is_for else distinguished_names.parse(name)  # strings may be of other types
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
            return
        if authorities:  # else their file is missing, which is reported
            yield from map(self._for_subject, verify_chain(pem, authorities, None, where))
        if subject != expected:
            message = f"is for {to_text(subject)!r}, not {to_text(expected)!r}"
            yield self._error("certificate-subject", CERTIFICATE, message)
        # Where the private key is elsewhere, the package has the public one.
        if anchors.public_key and keys.public_from_pem(anchors.public_key) != certificate.public_key():
            yield self._error("key-mismatch", CERTIFICATE, "is for another public key than the package has")
        own, unread = self.own_key
        yield from unread
        if own is not None and not keys.matches(own, certificate):
            yield self._error("key-mismatch", KEY, "is not the key of the certificate beside it")

    def _for_subject(self, diagnostic: Diagnostic) -> Diagnostic:
        return replace(diagnostic, where=diagnostic.where or self._where(""), subject=self._subject)

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
            if within >= end - begin - periods.back(end - begin):  # a new one would end too soon as well
                renew = "so does a new one: name a shorter time, or lengthen the validity ('keymint set valid-for')"
            yield self._warning(f"{code}-expires", name, message, renew)


def anchor_defects(anchors: Iterable[TrustAnchor]) -> Iterator[Diagnostic]:
    """Yield an error for each authority whose certificate the workspace lacks, or cannot read."""
    for anchor in dict.fromkeys(anchors):
        if not anchor.chain:
            message = f"the certificate of the authority {anchor.name!r} is missing, so nothing can be compared with it"
            help_ = "'keymint install' restores it if its key is here, else restore it from a backup of the workspace"
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
        for each in certificates.load_bundle(content, where):
            yield ValidityTerm(code, _titled(each), where, (certificates.period(each),))


@lru_cache(maxsize=64)
def _titled(certificate: x509.Certificate) -> str:
    return f"the certificate of {_shown(certificate.subject)}"


def utc_time(moment: datetime) -> str:
    """Return a moment for messages."""
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


# -- certification paths -----------------------------------------------------------------------------------------------


def verify_chain(
    certificate_pem: bytes, ca_pem_bundle: bytes, at: datetime | None, where: Origin | None = None
) -> list[Diagnostic]:
    """Verify a certificate against the trusted authorities, and return the findings.

    Args:
        certificate_pem: the certificate.
        ca_pem_bundle: authorities in any order: the issuer, and the others up to its self-signed root.
        at: the time at which every certificate of the path must be valid (aware); None: time does not matter.
        where: the certificate's file, for messages.

    Returns:
        Findings, none if the path is valid, with the codes ``certificate-invalid``, ``chain-incomplete``,
        ``chain-signature``, ``chain-not-authority``, ``chain-path-length``, ``chain-key-usage``,
        ``chain-critical-extension``, ``certificate-expired`` and ``certificate-not-yet-valid``.
    """
    path: list[x509.Certificate] = []
    problems: list[_Problem] = []
    unread: Sequence[Diagnostic] = ()
    try:
        path.append(certificates.load(certificate_pem, where))
        path, problem = _path(path[0], certificates.load_bundle(ca_pem_bundle, where))
        problems += [problem] if problem else []
    except KeymintError as error:
        unread = error.diagnostics  # the certificate, or its authorities: then it is checked alone
    problems += _certificate(path[0], at) if path else ()
    for depth, link in enumerate(path[1:], 1):
        problems += _link(link, at, tuple(path[1:depth]))
    return [*unread, *(Diagnostic.error(code, message, where, help_) for code, message, help_ in problems)]


_Problem = tuple[str, str, str]
"""Code, message and help of a finding."""


def _path(
    certificate: x509.Certificate, bundle: Sequence[x509.Certificate]
) -> tuple[list[x509.Certificate], _Problem | None]:
    """Return the path from a certificate upwards, and why it does not end at a self-signed one, if it does not."""
    path = [certificate]
    while len(path) <= _MAX_PATH:
        last = path[-1]
        # A workspace has few authorities, whose signatures are verified once.
        is_issued_by = certificates.is_issued_by if last is certificate else _is_issued_by
        if last.subject == last.issuer and (last in bundle or len(path) > 1):
            return path, None if is_issued_by(last, last) else _signature(last)
        named = [each for each in bundle if each.subject == last.issuer and each not in path]
        issuer = next((each for each in named if is_issued_by(last, each)), None)
        if issuer is None:
            if named:
                return path, _signature(last)
            break
        path.append(issuer)
    return path, (
        "chain-incomplete",
        f"the issuer {_shown(path[-1].issuer)} of {_shown(path[-1].subject)} is not among the authorities",
        "install it again, or add the missing authority",
    )


_is_issued_by = lru_cache(maxsize=64)(certificates.is_issued_by)


def _signature(certificate: x509.Certificate) -> _Problem:
    return (
        "chain-signature",
        f"{_shown(certificate.subject)} is not signed by the key of its issuer {_shown(certificate.issuer)}",
        "the certificate was altered, or the authority's key was replaced: install again",
    )


def _certificate(certificate: x509.Certificate, at: datetime | None) -> Iterator[_Problem]:
    """Check the dates of a certificate, if time matters, and its critical extensions."""
    begin, end = certificates.period(certificate)
    if at and at > end:
        yield (
            "certificate-expired",
            f"the certificate of {_shown(certificate.subject)} expired on {end:%Y-%m-%dT%H:%M:%SZ}",
            "'keymint renew' issues it again with later dates; that of an authority: 'keymint authority renew'",
        )
    elif at and at < begin:
        yield (
            "certificate-not-yet-valid",
            f"the certificate of {_shown(certificate.subject)} begins {begin:%Y-%m-%dT%H:%M:%SZ}",
            "compare the clock of this machine, or give it an earlier start",
        )
    for extension in certificate.extensions:
        if extension.critical and not isinstance(extension.value, _UNDERSTOOD):
            yield (
                "chain-critical-extension",
                f"{_shown(certificate.subject)} has an unknown critical extension, {extension.oid.dotted_string}",
                "make it not critical",
            )


@lru_cache(maxsize=64)
def _link(authority: x509.Certificate, at: datetime | None, below: tuple[x509.Certificate, ...]) -> Sequence[_Problem]:
    """Check an authority of a path; arguments as for :func:`_certificate` and :func:`_authority`."""
    return [*_certificate(authority, at), *_authority(authority, below)]


def _authority(certificate: x509.Certificate, below: Sequence[x509.Certificate]) -> Iterator[_Problem]:
    """Check an authority of a path; ``below`` are the authorities between it and the end (RFC 5280, 6.1.4)."""
    constraints = extensions.value(certificate, x509.BasicConstraints)
    if constraints is None or not constraints.ca:
        yield (
            "chain-not-authority",
            f"{_shown(certificate.subject)} issued a certificate, but is not an authority",
            "name another issuer",
        )
        return
    intermediates = sum(1 for each in below if each.subject != each.issuer)
    most = constraints.path_length
    if most is not None and intermediates > most:
        yield (
            "chain-path-length",
            f"{_shown(certificate.subject)} has pathlen:{most}, and {intermediates} authorities are below it",
            "raise its pathlen, or name another issuer",
        )
    if not extensions.may(certificate, "keyCertSign"):
        yield (
            "chain-key-usage",
            f"the keyUsage of {_shown(certificate.subject)} lacks keyCertSign",
            "add it, or name another issuer",
        )


def _shown(name: x509.Name) -> str:
    return repr(distinguished_names.to_text(name))


# -- who signs ---------------------------------------------------------------------------------------------------------


def issuer_with(certificate: x509.Certificate, key: keys.PrivateKey, where: Origin) -> certificates.Issuer:
    """Return an authority with its private key.

    Args:
        certificate: its certificate.
        key: its key.
        where: the authority, for messages.

    Raises:
        KeymintError: they do not belong together.
    """
    if not keys.matches(key, certificate):
        message = "the private key does not belong to the certificate"
        raise KeymintError(message, where=where, help="restore the replaced file", code="key-mismatch")
    return certificates.Issuer(certificate, key)


def require_signer(authority: x509.Certificate, at: datetime | None) -> None:
    """Require that an authority may sign documents.

    Args:
        authority: its certificate.
        at: the time at which it must be valid (aware); None: time does not matter.

    Raises:
        KeymintError: it may not, or not at this time.
    """
    if problem := certificates.can_sign_documents(authority):
        raise KeymintError.of([problem])
    begin, end = certificates.period(authority)
    if at is not None and not begin <= at <= end:
        message = f"the authority's certificate is valid from {begin:%Y-%m-%d} to {end:%Y-%m-%d}, not at {at:%Y-%m-%d}"
        help_ = "extend the validity of the authority in the profile, then install"
        raise KeymintError(message, help=help_, code="smime-authority-expired")
