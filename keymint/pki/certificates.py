"""Certificates: issued from a specification, and held against it so that none is issued again without need."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.text import quoted
from keymint.api import CertificateSpec
from keymint.errors import KeymintError
from keymint.pki import der, extensions, forms, keys, names

_UNREADABLE = (
    ValueError,
    TypeError,
    KeyError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
    UserWarning,  # where warnings are errors: a serial number of 0, a country of three letters
)
"""What the library raises on a damaged certificate."""
_BEGIN, _END = b"-----BEGIN CERTIFICATE-----", b"-----END CERTIFICATE-----"


@dataclass(frozen=True, slots=True)
class Issuer:
    """An authority that issues: its certificate and its private key."""

    certificate: x509.Certificate
    key: keys.PrivateKey = field(repr=False)


@dataclass(frozen=True, slots=True)
class Issued:
    """A certificate, issued: as an object, as PEM, and what is to be said of it."""

    certificate: x509.Certificate
    pem: bytes
    diagnostics: tuple[Diagnostic, ...] = ()


def load(pem: bytes, where: Origin | None = None) -> x509.Certificate:
    """Return the one certificate of a PEM file.

    Raises:
        KeymintError: none, several, or not a certificate.
    """
    found = load_bundle(pem, where)
    if len(found) != 1:
        raise KeymintError(f"{len(found)} certificates where one was expected", where=where, code="certificate-invalid")
    return found[0]


def load_bundle(pem: bytes, where: Origin | None = None) -> tuple[x509.Certificate, ...]:
    """Return the certificates of a PEM file, at least one, in its order.

    Raises:
        KeymintError: no certificate, or not a certificate.
    """
    try:
        return _parsed(pem)
    except _UNREADABLE:
        raise KeymintError(
            "not a certificate in PEM, or a damaged one",
            where=where,
            help="restore the file from a backup, or run 'keymint install'",
            code="certificate-invalid",
        ) from None


def load_first(pem: bytes, where: Origin | None = None) -> x509.Certificate:
    """Return the first certificate of a PEM file: the permissions authority, as Cyclone DDS and OpenDDS read it.

    Readers of PEM differ in what they take for the beginning of a block: text before it in its line, blocks with other
    labels such as ``TRUSTED CERTIFICATE``. So five hyphens may only stand in the first and last line of a block of a
    certificate, whose base64 is in the form of RFC 7468. Other text may come before, between and after.

    Raises:
        KeymintError: no certificate, or a file that readers of PEM may read differently.
    """
    lines = pem.replace(b"\r\n", b"\n").split(b"\n")
    marks = [line for line in lines if b"-----" in line]
    pairs = [_BEGIN, _END] * (len(marks) // 2)
    found = load_bundle(pem, where)
    if marks != pairs or b"\r" in b"".join(lines) or b"\0" in pem:
        problem = "has lines beside its certificates that other readers of PEM may take for the beginning of one"
    elif b"\n".join(lines[lines.index(_BEGIN) : lines.index(_END) + 1]) + b"\n" != to_pem(found[0]):
        problem = "is not exactly the encoding of the certificate that it holds"
    else:
        return found[0]
    raise KeymintError(
        f"the certificate of the authority {problem}",
        where=where,
        help="install it again, or rewrite it: openssl x509 -in FILE -out FILE",
        code="certificate-ambiguous",
    )


@functools.lru_cache(maxsize=64)
def _parsed(pem: bytes) -> tuple[x509.Certificate, ...]:
    """Parse certificates, whole; cached, since every document of a workspace is held against the same few."""
    found = tuple(x509.load_pem_x509_certificates(pem))
    for certificate in found:
        # The library parses lazily: what is damaged is to be found here.
        _ = certificate.extensions, certificate.subject, certificate.issuer, certificate.public_key()
        _ = certificate.not_valid_before_utc, certificate.not_valid_after_utc, certificate.signature_hash_algorithm
        signature = der.elements(der.single(certificate.public_bytes(serialization.Encoding.DER), der.SEQUENCE))[-1][1]
        if not signature.startswith(b"\0"):
            raise ValueError("unused bits of a signature, that no signature covers")
    return found


def public_key(certificate: x509.Certificate, where: Origin | None = None) -> keys.PublicKey:
    """Return the key that a certificate certifies.

    Raises:
        KeymintError: it is of an algorithm that no key of ours is of.
    """
    found = certificate.public_key()
    if not isinstance(found, keys.PublicKey):
        raise KeymintError(
            "certifies neither an EC nor an RSA key",
            where=where,
            help="restore the file from a backup, or run 'keymint install'",
            code="certificate-invalid",
        )
    return found


def to_pem(certificate: x509.Certificate) -> bytes:
    """Return a certificate as PEM."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def is_canonical(pem: bytes) -> bool:
    """Tell whether the bytes of a file are exactly the PEM of the certificates that it holds."""
    try:
        return b"".join(map(to_pem, load_bundle(pem))) == pem
    except KeymintError:
        return False


def issue_authority(spec: CertificateSpec, key: keys.PrivateKey, issuer: Issuer | None) -> Issued:
    """Issue the certificate of an authority.

    Defaults that the specification's extensions replace one by one: basicConstraints CA:TRUE and keyUsage
    digitalSignature (it signs documents), keyCertSign, cRLSign, both critical; subjectKeyIdentifier; and unless
    it is self-signed authorityKeyIdentifier (RFC 5280, 4.2.1).

    Args:
        spec: what is asked for.
        key: the authority's own private key.
        issuer: who issues it; None for a self-signed certificate.

    Returns:
        The certificate, with a warning when its validity was cut to the issuer's.

    Raises:
        KeymintError: with the place of what cannot be issued.
    """
    if issuer is None:
        return _issue(spec, key.public_key(), None, key, forms.Role.AUTHORITY)
    return _issue(spec, key.public_key(), issuer.certificate, issuer.key, forms.Role.AUTHORITY)


def issue_identity(spec: CertificateSpec, public_key: keys.PublicKey, issuer: Issuer) -> Issued:
    """Issue the certificate of an identity.

    Defaults that the specification's extensions replace one by one: basicConstraints CA:FALSE and keyUsage
    digitalSignature, both critical; extendedKeyUsage serverAuth and clientAuth; subjectKeyIdentifier and
    authorityKeyIdentifier. An extendedKeyUsage is always there and never has emailProtection: where one
    authority has both jobs, an identity's key could else sign permissions of its own (CVE-2023-24010).

    Args:
        spec: what is asked for.
        public_key: the identity's public key.
        issuer: who issues it.

    Returns:
        The certificate, with a warning when its validity was cut to the issuer's.

    Raises:
        KeymintError: with the place of what cannot be issued.
    """
    return _issue(spec, public_key, issuer.certificate, issuer.key, forms.Role.IDENTITY)


def certificate_satisfies(
    pem: bytes,
    spec: CertificateSpec,
    public_key: keys.PublicKey,
    issuer: x509.Certificate | None,
    *,
    authority: bool,
) -> bool:
    """Tell whether an existing certificate is what issuing would give again, so that there is no need to.

    Compared are subject, validity (cut to the issuer's), serial number where one is asked for, hash, public
    key, extensions, and issuer by name and signature.

    Args:
        pem: the existing certificate's file.
        spec: what is asked for.
        public_key: the key that it is to certify.
        issuer: certificate of the issuer as it is now; None for a self-signed certificate.
        authority: an authority's certificate is compared, else an identity's.

    Raises:
        KeymintError: as issuing would.
    """
    role = forms.Role.AUTHORITY if authority else forms.Role.IDENTITY
    form, _ = forms.form(spec, public_key, issuer, role)
    try:
        certificate = load(pem)
        certificate.verify_directly_issued_by(issuer or certificate)
    except (KeymintError, ValueError, TypeError, InvalidSignature):
        return False
    hash_algorithm = certificate.signature_hash_algorithm
    return (
        to_pem(certificate) == pem
        and certificate.public_key() == public_key
        and certificate.subject == form.subject
        and certificate.not_valid_before_utc == form.validity.not_before
        and certificate.not_valid_after_utc == form.validity.not_after
        and spec.serial in (None, certificate.serial_number)
        and hash_algorithm is not None
        and hash_algorithm.name == form.hash_algorithm.name
        and {each.oid: (each.critical, each.value.public_bytes()) for each in certificate.extensions}
        == {oid: (critical, value.public_bytes()) for oid, (critical, value) in form.extensions.items()}
    )


def can_sign_documents(certificate: x509.Certificate, where: Origin | None = None) -> Diagnostic | None:
    """Return why an authority may not sign permissions and governance, or None when it may.

    What OpenSSL's purpose ``smimesign`` demands (RFC 8550, 4.4.2 and 4.4.4), on which older releases of the
    DDS vendors insist.
    """
    usage = extensions.value(certificate, x509.KeyUsage)
    extended = extensions.value(certificate, x509.ExtendedKeyUsage)
    if usage is not None and not (usage.digital_signature or usage.content_commitment):
        problem, help_ = "keyUsage lacks digitalSignature", "add digitalSignature to its keyUsage"
    elif extended is not None and ExtendedKeyUsageOID.EMAIL_PROTECTION not in extended:
        problem, help_ = "extendedKeyUsage lacks emailProtection", "leave extendedKeyUsage out"
    else:
        return None
    return Diagnostic(
        "authority-cannot-sign",
        Severity.ERROR,
        f"the certificate of {names.to_text(certificate.subject)!r} cannot sign documents: its {problem}",
        where,
        help_,
    )


def _issue(
    spec: CertificateSpec,
    public_key: keys.PublicKey,
    issuer: x509.Certificate | None,
    signing_key: keys.PrivateKey,
    role: forms.Role,
) -> Issued:
    form, diagnostics = forms.form(spec, public_key, issuer, role)
    serial = x509.random_serial_number() if spec.serial is None else spec.serial
    builder = (
        x509.CertificateBuilder()
        .issuer_name(form.issuer)
        .subject_name(form.subject)
        .public_key(public_key)
        .serial_number(serial)
        .not_valid_before(form.validity.not_before)
        .not_valid_after(form.validity.not_after)
    )
    for critical, value in form.extensions.values():
        builder = builder.add_extension(value, critical)
    certificate = builder.sign(signing_key, form.hash_algorithm)
    try:
        _ = certificate.extensions
    except ValueError:  # a dotted OID that the library knows, with bytes that are not its syntax
        raise KeymintError(
            f"an extension of {quoted(spec.subject_name, 80)} is not in the syntax of its OID",
            where=spec.origin,
            help="correct the value after DER:",
            code="extension-invalid",
        ) from None
    return Issued(certificate, to_pem(certificate), diagnostics)
