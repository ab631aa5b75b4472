# SPDX-License-Identifier: Apache-2.0
"""Certificates: issued from a specification, and compared with it so that none is issued again without need."""

from __future__ import annotations

import base64
import functools
import re
from datetime import datetime
from typing import cast

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.x509.oid import ExtendedKeyUsageOID

from comarmor.text import lazy_regex, quote
from comarmor.values import Data, field
from keymint.api import CertificateSpec
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificate_forms, der, distinguished_names, extensions, keys
from keymint.pki.distinguished_names import to_text

MAX_BYTES = 1 << 20
"""Largest file of certificates in bytes; the authorities of a public key infrastructure take some thousand."""
RESTORE = "restore the file from a backup; in a workspace, 'keymint install' makes that of an enclave again"

UNREADABLE = (
    ValueError,
    TypeError,
    KeyError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
    UserWarning,  # where warnings are errors: a serial number of 0, a country of three letters
)
"""What the library raises on a damaged certificate or revocation list."""
_CERTIFICATE, _LIST = b"CERTIFICATE", b"X509 CRL"
BEGIN = b"-----BEGIN %b-----" % _CERTIFICATE
"""What a certificate in PEM begins with."""
_BLOCK = lazy_regex(rb"^-----BEGIN (%b|%b)-----\n[^-]*^-----END \1-----$" % (_CERTIFICATE, _LIST), re.MULTILINE)
"""A certificate, or a revocation list, which may follow the certificates of authorities in their file."""


class Issuer(Data):
    """An authority with its private key, which issues certificates and signs documents."""

    certificate: x509.Certificate
    key: keys.PrivateKey = field(repr=False)


class Issued(Data):
    """An issued certificate: as an object and as PEM, with its diagnostics."""

    certificate: x509.Certificate
    pem: bytes
    diagnostics: tuple[Diagnostic, ...] = ()


def load(pem: bytes, where: Origin | None = None) -> x509.Certificate:
    """Return the one certificate of a PEM file.

    Raises:
        KeymintError: none, several, or not a certificate.
    """
    bundle = load_bundle(pem, where)
    if len(bundle) != 1:
        raise KeymintError(
            f"expected one certificate, the file has {len(bundle)}", where=where, code="certificate-invalid"
        )
    return bundle[0]


def certificate_in(pem: bytes | None) -> x509.Certificate | None:
    """Return the one certificate of a PEM file, with an EC or RSA key; None if the file has no such one."""
    try:
        certificate = load(pem or b"")
        public_key(certificate)
    except KeymintError:
        return None
    return certificate


def load_bundle(pem: bytes, where: Origin | None = None) -> tuple[x509.Certificate, ...]:
    """Return the certificates of a PEM file, at least one, in the file's order.

    Raises:
        KeymintError: no certificate, or not a certificate, or the file is too large.
    """
    if len(pem) > MAX_BYTES:
        raise KeymintError(
            f"has {len(pem):,} bytes, {MAX_BYTES:,} are the most for certificates", where=where, code="file-size"
        )
    try:
        return _parsed(pem)
    except UNREADABLE:
        raise KeymintError(
            "not a certificate in PEM, or a damaged one",
            where=where,
            help=RESTORE,
            code="certificate-invalid",
        ) from None


@functools.lru_cache(maxsize=16)
def load_first(pem: bytes, where: Origin | None = None, *, with_lists: bool = False) -> x509.Certificate:
    """Return the first certificate of a PEM file: the one that software which expects one authority reads.

    PEM readers differ in what begins a block: some accept text before it in its line, or other labels such as
    ``TRUSTED CERTIFICATE``. So five hyphens may only occur in the first and last line of a certificate's block, and its
    base64 must have the form of RFC 7468. Other text may come before, between and after.

    Args:
        pem: the file.
        where: the file, for messages.
        with_lists: revocation lists may lie beside the certificates, as where two authorities are trusted.

    Raises:
        KeymintError: no certificate, or a file that readers of PEM may read differently.
    """
    text, bundle = pem.replace(b"\r\n", b"\n"), load_bundle(pem, where)
    if pem == to_pem(bundle[0]):  # it is all of the file, as of most
        return bundle[0]
    blocks = list(_BLOCK.finditer(text))
    first = next((each[0] for each in blocks if each[1] == _CERTIFICATE), b"")
    has_others = b"-----" in _BLOCK.sub(b"", text) or (not with_lists and any(each[1] == _LIST for each in blocks))
    if has_others or b"\r" in text or b"\0" in text:
        problem = "has lines beside its certificates that other PEM readers may take for the beginning of one"
    elif first + b"\n" != to_pem(bundle[0]):
        problem = "is not exactly the encoding of its certificate"
    else:
        return bundle[0]
    message = f"the certificate of the authority {problem}"
    help_ = "install it again, or rewrite it: openssl x509 -in FILE -out FILE"
    raise KeymintError(message, where=where, help=help_, code="certificate-ambiguous")


@functools.lru_cache(maxsize=1 << 10)
def _parsed(pem: bytes) -> tuple[x509.Certificate, ...]:
    """Parse certificates completely; cached, because several rules ask about one."""
    certificates = tuple(x509.load_pem_x509_certificates(pem))
    for certificate in certificates:
        # The library parses lazily: touch every part, so that damage is detected here.
        _ = certificate.extensions, certificate.subject, certificate.issuer, certificate.public_key()
        _ = period(certificate), certificate.signature_hash_algorithm
        if not der.der_of(certificate).endswith(b"\0" + certificate.signature):
            raise ValueError("unused bits of a signature, which no signature covers")
    return certificates


def public_key(certificate: x509.Certificate, where: Origin | None = None) -> keys.PublicKey:
    """Return the public key of a certificate.

    Raises:
        KeymintError: the key is neither EC nor RSA.
    """
    key = certificate.public_key()
    if not isinstance(key, keys.PublicKey):
        message = "certifies neither an EC nor an RSA key"
        raise KeymintError(message, where=where, help=RESTORE, code="certificate-invalid")
    return key


def fingerprint(certificate: x509.Certificate) -> str:
    """Return the fingerprint of the public key of a certificate; see :func:`keymint.pki.keys.fingerprint`."""
    return keys.fingerprint(public_key(certificate))


def to_pem(certificate: x509.Certificate) -> bytes:
    """Return a certificate as PEM."""
    return pem_of(der.der_of(certificate))


def pem_of(content: bytes) -> bytes:
    """Return a certificate in DER as PEM, as :func:`to_pem` writes it."""
    return der.pem(_CERTIFICATE, content)


def period(certificate: x509.Certificate) -> tuple[datetime, datetime]:
    """Return when a certificate is in force, UTC, both ends included."""
    return certificate.not_valid_before_utc, certificate.not_valid_after_utc


def is_issued_by(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    """Return whether a certificate names an issuer and has the signature of its key (RFC 5280, 6.1.3 and 4.1.1.2)."""
    try:
        key, digest = issuer.public_key(), certificate.signature_hash_algorithm
        if isinstance(key, keys.PublicKey) and isinstance(digest, certificate_forms.Hash):
            expected = certificate_forms.signature_algorithm(key, digest)
            body, algorithm, _ = der.elements(der.single(der.der_of(certificate), der.SEQUENCE))
            if algorithm == expected and expected in der.elements(der.single(body, der.SEQUENCE)):
                is_named = certificate.issuer.public_bytes() == issuer.subject.public_bytes()
                return is_named and keys.verifies(certificate.signature, body, key, digest)
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def is_canonical(pem: bytes) -> bool:
    """Return whether a file is exactly the PEM encoding of its certificates."""
    try:
        return b"".join(map(to_pem, load_bundle(pem))) == pem
    except KeymintError:
        return False


def issue(
    spec: CertificateSpec, public_key: keys.PublicKey, signer: Issuer | keys.PrivateKey, *, authority: bool
) -> Issued:
    """Issue the certificate of an authority or an identity.

    Defaults for an authority, each replaced by the specification's extension of the same kind: basicConstraints CA:TRUE
    and keyUsage digitalSignature (it signs documents), keyCertSign, cRLSign, both critical; subjectKeyIdentifier; and,
    unless it is self-signed, authorityKeyIdentifier (RFC 5280, 4.2.1).

    Those for an identity: basicConstraints CA:FALSE and keyUsage digitalSignature, both critical; extendedKeyUsage
    serverAuth and clientAuth; subjectKeyIdentifier and authorityKeyIdentifier. An extendedKeyUsage is always present
    and never has emailProtection: where one authority has both jobs, an identity's key could otherwise sign its own
    permissions (CVE-2023-24010).

    Args:
        spec: the specification.
        public_key: the key to certify.
        signer: the issuing authority, or the authority's own private key for a self-signed certificate.
        authority: whether it is an authority's certificate, not an identity's.

    Returns:
        The certificate, with a warning if its validity was cut to the issuer's.

    Raises:
        KeymintError: the specification cannot be issued; with its origin.
    """
    issuer, signing_key = (signer.certificate, signer.key) if isinstance(signer, Issuer) else (None, signer)
    form = certificate_forms.form(spec, public_key, issuer, authority=authority)
    certificate = form.signed(spec.serial, public_key, signing_key)
    try:
        _ = certificate.extensions if spec.extensions else ()
    except ValueError:  # a dotted OID that the library knows, with a value in another syntax
        raise KeymintError(
            f"an extension of {quote(spec.subject_name, 80)} does not have the syntax of its OID",
            where=spec.origin,
            help="correct the value after DER:",
            code="extension-invalid",
        ) from None
    return Issued(certificate, to_pem(certificate), form.diagnostics)


def is_like(
    pem: bytes, parts: certificate_forms.CommonParts, subject: bytes, public: bytes, issuer: x509.Certificate
) -> bool:
    """Return whether a file is a certificate that its issuer signed, and differs from another one as it must.

    Args:
        pem: the file.
        parts: what it must share with the other one.
        subject: its subject, in DER.
        public: the key that it must certify, in DER.
        issuer: the certificate of its issuer, which the other one was verified with.
    """
    signed_by = cast("keys.PublicKey", issuer.public_key())
    try:
        content = base64.b64decode(b"".join(pem.split(b"\n")[1:-2]))
        return pem == pem_of(content) and parts.are_in(content, subject, public, signed_by)
    except ValueError:
        return False


def certificate_satisfies(
    pem: bytes,
    spec: CertificateSpec,
    public_key: keys.PublicKey,
    issuer: x509.Certificate | None,
    *,
    authority: bool,
) -> bool:
    """Return whether an existing certificate equals what would be issued, so that issuing is unnecessary.

    Compares subject, validity (cut to the issuer's), serial number if specified, hash, public key, extensions, and
    issuer by name and signature.

    Args:
        pem: the existing certificate's file.
        spec: the specification.
        public_key: the key to certify.
        issuer: the issuer's current certificate; None for a self-signed certificate.
        authority: whether it is an authority's certificate, not an identity's.

    Raises:
        KeymintError: as issuing would.
    """
    form = certificate_forms.form(spec, public_key, issuer, authority=authority)
    try:
        certificate = load(pem)
    except KeymintError:
        return False
    hash_algorithm = certificate.signature_hash_algorithm
    return (
        is_issued_by(certificate, issuer or certificate)
        and to_pem(certificate) == pem
        and certificate.public_key() == public_key
        and certificate.subject == form.subject
        and period(certificate) == (form.validity.not_before, form.validity.not_after)
        and spec.serial in (None, certificate.serial_number)
        and hash_algorithm is not None
        and hash_algorithm.name == form.hash_algorithm.name
        and {each.oid: (each.critical, each.value.public_bytes()) for each in certificate.extensions}
        == {oid: (critical, value.public_bytes()) for oid, (critical, value) in form.extensions.items()}
    )


def certificate_fits(pem: bytes, spec: CertificateSpec, public_key: keys.PublicKey, issuer: x509.Certificate) -> bool:
    """Return whether an identity's certificate of another tool is for what a specification asks for.

    Its hash, serial number and extensions may be others than those that would be issued.

    Args:
        pem: the certificate.
        spec: the specification.
        public_key: the key to certify.
        issuer: the issuer's current certificate.

    Raises:
        KeymintError: the specification's subject name is none.
    """
    certificate = load(pem)
    return (
        is_issued_by(certificate, issuer)
        and certificate.public_key() == public_key
        and certificate.subject == distinguished_names.parse(spec.subject_name, spec.origin)
        and period(certificate) == (spec.validity.not_before, spec.validity.not_after)
    )


def is_same(pem: bytes, other: bytes) -> bool:
    """Return whether two files have the same certificate, however they encode it; False if the first has none."""
    certificate = certificate_in(pem)
    return certificate is not None and certificate == certificate_in(other)


@functools.lru_cache(maxsize=16)
def can_sign_documents(certificate: x509.Certificate) -> Diagnostic | None:
    """Return why an authority may not sign documents, or None if it may.

    These are the rules of OpenSSL's purpose ``smimesign`` (RFC 8550, 4.4.2 and 4.4.4), which some software
    that verifies documents enforces.
    """
    extended = extensions.value(certificate, x509.ExtendedKeyUsage)
    if not extensions.may(certificate, "digitalSignature", "contentCommitment"):
        problem, help_ = "keyUsage lacks digitalSignature", "add digitalSignature to its keyUsage"
    elif extended is not None and ExtendedKeyUsageOID.EMAIL_PROTECTION not in extended:
        problem, help_ = "extendedKeyUsage lacks emailProtection", "leave extendedKeyUsage out"
    else:
        return None
    message = f"the certificate of {to_text(certificate.subject)!r} cannot sign documents: its {problem}"
    return Diagnostic.error("authority-cannot-sign", message, None, help_)
