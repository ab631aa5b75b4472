# SPDX-License-Identifier: Apache-2.0
"""Certificates of authorities that somebody else issued: used as they are, and issued again with what they lack."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtensionOID

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import CertificateSpec, Validity
from keymint.errors import KeymintError
from keymint.pki import certificates, extensions, forms, keys
from keymint.pki.certificates import Issuer
from keymint.pki.distinguished_names import to_text

_OWN = (
    ExtensionOID.BASIC_CONSTRAINTS,
    ExtensionOID.KEY_USAGE,
    ExtensionOID.SUBJECT_KEY_IDENTIFIER,
    ExtensionOID.AUTHORITY_KEY_IDENTIFIER,
)
"""The extensions that a certificate which is issued again has from Keymint."""


def adopted(spec: CertificateSpec, pem: bytes) -> CertificateSpec:
    """Return the specification that a certificate from elsewhere fulfils.

    Args:
        spec: what the profile specifies: the issuer, where the key is, and places for messages.
        pem: the certificate of an authority, with an EC or RSA key.
    """
    certificate = certificates.load(pem)
    public = certificates.public_key(certificate)
    algorithm = certificate.signature_hash_algorithm
    if isinstance(public, ec.EllipticCurvePublicKey):
        curve = next((name for name, each in keys.CURVES.items() if each.name == public.curve.name), "")
        key = replace(spec.key, algorithm="ec", curve=curve, size=0)
    else:
        key = replace(spec.key, algorithm="rsa", curve="", size=public.key_size)
    return replace(
        spec,
        subject_name=to_text(certificate.subject),
        validity=Validity(certificate.not_valid_before_utc, certificate.not_valid_after_utc, spec.validity.origin),
        serial=certificate.serial_number,
        hash_algorithm=algorithm.name.upper() if algorithm else spec.hash_algorithm,
        key=key,
        extensions=(),
        adopted=pem,
    )


def require_authority(pem: bytes, where: Origin) -> x509.Certificate:
    """Return the certificate of an authority.

    Args:
        pem: a file with one certificate.
        where: the file, for messages.

    Raises:
        KeymintError: the file has none or several, its key is of an unsupported kind, or it may not issue certificates
            (RFC 5280, 4.2.1.3 and 4.2.1.9).
    """
    certificate = certificates.load(pem, where)
    public = certificates.public_key(certificate, where)
    constraints = extensions.value(certificate, x509.BasicConstraints)
    usage = extensions.value(certificate, x509.KeyUsage)
    problem, help_ = "", "name the certificate of an authority"
    if constraints is None or not constraints.ca:
        problem = "is not the certificate of an authority: its basicConstraints lack CA:TRUE"
    elif usage is not None and not usage.key_cert_sign:
        problem = "may not issue certificates: its keyUsage lacks keyCertSign"
    elif isinstance(public, ec.EllipticCurvePublicKey) and not any(
        each.name == public.curve.name for each in keys.CURVES.values()
    ):
        problem = f"has a key on the curve {public.curve.name}, which is not supported"
        help_ = f"supported are {', '.join(keys.CURVES)}, and RSA keys"
    elif not isinstance(public, ec.EllipticCurvePublicKey) and public.key_size < keys.MIN_RSA_BITS:
        problem = f"has an RSA key of {public.key_size} bits, expected at least {keys.MIN_RSA_BITS}"
    if problem:
        raise KeymintError(problem, where=where, help=help_, code="authority-unsuitable")
    return certificate


def lacking(certificate: x509.Certificate, name: str, where: Origin) -> Iterator[Diagnostic]:
    """Yield a warning for each thing that an authority's certificate lacks, and that will be missed.

    Args:
        certificate: its certificate.
        name: its name in the profile.
        where: the file, for messages.
    """
    renew = f"'keymint authority renew {name}' adds it, where its key is; <extensions> in authorities.xml come first"
    usage = extensions.value(certificate, x509.KeyUsage)
    if usage is not None and not usage.crl_sign:
        message = f"the certificate of {name!r} cannot sign revocation lists: its keyUsage lacks cRLSign"
        yield Diagnostic("authority-cannot-revoke", Severity.WARNING, message, where, renew)
    if extensions.value(certificate, x509.SubjectKeyIdentifier) is None:
        message = (
            f"the certificate of {name!r} has no subjectKeyIdentifier, so it cannot be told from another authority of "
            "its name, and its key not be replaced step by step"
        )
        yield Diagnostic("authority-without-identifier", Severity.WARNING, message, where, renew)


def issued_like(
    certificate: x509.Certificate, key: keys.PrivateKey, validity: Validity, issuer: Issuer | None, where: Origin
) -> bytes:
    """Issue a certificate with the name and the extensions of another one, PEM.

    It has what :func:`lacking` looks for: the key identifiers, and cRLSign.

    Args:
        certificate: the certificate to follow.
        key: the authority's own private key.
        validity: of the new one, UTC; cut to the issuer's.
        issuer: the issuing authority; None for a self-signed certificate.
        where: the file, for messages.

    Raises:
        KeymintError: the certificate was issued by an authority that is not in the workspace, or its issuer's validity
            is over.
    """
    if issuer is None and certificate.issuer != certificate.subject:
        raise KeymintError(
            f"was issued by {to_text(certificate.issuer)!r}, which is not in the workspace",
            where=where,
            help="let that authority issue a new one, and run 'keymint authority import'",
            code="authority-issuer-elsewhere",
        )
    public = key.public_key()
    first = validity.not_before.astimezone(UTC).replace(microsecond=0)
    last = validity.not_after.astimezone(UTC).replace(microsecond=0)
    if issuer is not None:
        first = max(first, issuer.certificate.not_valid_before_utc)
        last = min(last, issuer.certificate.not_valid_after_utc)
    if first >= last:
        raise KeymintError(
            "the validity of the new certificate would be empty: its issuer's ends before",
            where=where,
            help="renew the issuer first",
            code="validity-empty",
        )
    constraints = extensions.value(certificate, x509.BasicConstraints)
    builder = (
        x509.CertificateBuilder()
        .issuer_name(issuer.certificate.subject if issuer else certificate.subject)
        .subject_name(certificate.subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(first)
        .not_valid_after(last)
        .add_extension(x509.BasicConstraints(True, constraints.path_length if constraints else None), critical=True)
        .add_extension(_usage(certificate), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
    )
    if issuer is not None:
        builder = builder.add_extension(extensions.authority_key_identifier(issuer.certificate), critical=False)
    for each in certificate.extensions:
        if each.oid not in _OWN:
            builder = builder.add_extension(each.value, critical=each.critical)
    algorithm = certificate.signature_hash_algorithm
    known = forms.HASHES.get(algorithm.name.upper() if algorithm else "", forms.HASHES["SHA256"])
    return certificates.to_pem(builder.sign(issuer.key if issuer else key, known))


def _usage(certificate: x509.Certificate) -> x509.KeyUsage:
    """Return the key usage of a certificate with cRLSign; the default of authorities if it has none."""
    usage = extensions.value(certificate, x509.KeyUsage)
    if usage is None:
        return extensions.key_usage("digitalSignature", "keyCertSign", "cRLSign")
    return extensions.key_usage(*dict.fromkeys((*extensions.usages(usage), "keyCertSign", "cRLSign")))
