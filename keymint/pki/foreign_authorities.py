# SPDX-License-Identifier: Apache-2.0
"""Certificates of authorities that somebody else issued: used as they are, and issued again with what they lack."""

from __future__ import annotations

from collections.abc import Iterator

from cryptography import x509
from cryptography.x509.oid import ExtensionOID

from comarmor.values import replace
from keymint.api import CertificateSpec, Validity
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificate_forms, certificates, extensions, keys
from keymint.pki.certificates import Issuer
from keymint.pki.distinguished_names import to_text

_OWN = (
    ExtensionOID.BASIC_CONSTRAINTS,
    ExtensionOID.KEY_USAGE,
    ExtensionOID.SUBJECT_KEY_IDENTIFIER,
    ExtensionOID.AUTHORITY_KEY_IDENTIFIER,
)
"""The extensions that a certificate which is issued again has from Keymint."""


def adopted_spec(spec: CertificateSpec, pem: bytes) -> CertificateSpec:
    """Return the specification that a certificate from elsewhere fulfils.

    Args:
        spec: what the profile specifies: the issuer, where the key is, and places for messages.
        pem: the certificate of an authority, with an EC or RSA key.
    """
    certificate = certificates.load(pem)
    kind = keys.kind_of(certificates.public_key(certificate))
    algorithm = certificate.signature_hash_algorithm
    return replace(
        spec,
        subject_name=to_text(certificate.subject),
        validity=Validity(*certificates.period(certificate), spec.validity.origin),
        serial=certificate.serial_number,
        hash_algorithm=algorithm.name.upper() if algorithm else spec.hash_algorithm,
        key=replace(spec.key, algorithm=kind.algorithm, curve=kind.curve, size=kind.size),
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
    kind = keys.kind_of(certificates.public_key(certificate, where))
    problem, help_ = "", "name the certificate of an authority"
    if why := extensions.not_an_authority(certificate):
        problem = f"is not the certificate of an authority: {why}"
    elif kind.algorithm == "rsa" and kind.size < keys.MIN_RSA_BITS:
        problem = f"has an RSA key of {kind.size} bits, expected at least {keys.MIN_RSA_BITS}"
    elif kind.algorithm == "ec" and kind.curve not in keys.CURVES:
        problem = f"has a key on the curve {kind.curve}, which is not supported"
        help_ = f"supported are {', '.join(keys.CURVES)}, and RSA keys"
    if problem:
        raise KeymintError(problem, where=where, help=help_, code="authority-unsuitable")
    return certificate


def defects(certificate: x509.Certificate, name: str, where: Origin) -> Iterator[Diagnostic]:
    """Yield a warning for each thing that an authority's certificate lacks, and that will be missed.

    Args:
        certificate: its certificate.
        name: its name in the profile.
        where: the file, for messages.
    """
    renew = f"'keymint authority renew {name}' adds it, where its key is; <extensions> in authorities.xml come first"
    if not extensions.may(certificate, "cRLSign"):
        message = f"the certificate of {name!r} cannot sign revocation lists: its keyUsage lacks cRLSign"
        yield Diagnostic.warning("authority-cannot-revoke", message, where, renew)
    if extensions.value(certificate, x509.SubjectKeyIdentifier) is None:
        message = (
            f"the certificate of {name!r} has no subjectKeyIdentifier, so it cannot be told from another authority of "
            "its name, and its key not be replaced step by step"
        )
        yield Diagnostic.warning("authority-without-identifier", message, where, renew)


def issued_like(
    certificate: x509.Certificate, key: keys.PrivateKey, validity: Validity, issuer: Issuer | None, where: Origin
) -> bytes:
    """Issue a certificate with the name and the extensions of another one, PEM.

    It has what :func:`defects` looks for: the key identifiers, and cRLSign.

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
        message = f"was issued by {to_text(certificate.issuer)!r}, which is not in the workspace"
        help_ = "let that authority issue a new one, and run 'keymint authority import'"
        raise KeymintError(message, where=where, help=help_, code="authority-issuer-elsewhere")
    above, public = issuer.certificate if issuer else None, key.public_key()
    validity = certificate_forms.checked_validity(validity, above, where)
    values = certificate_forms.defaults(extensions.Context(public, above), authority=True)
    if constraints := extensions.value(certificate, x509.BasicConstraints):
        values[ExtensionOID.BASIC_CONSTRAINTS] = (True, x509.BasicConstraints(True, constraints.path_length))
    if (usages := extensions.usages(certificate)) is not None:
        values[ExtensionOID.KEY_USAGE] = (True, extensions.key_usage(*usages, "keyCertSign", "cRLSign"))
    values |= {each.oid: (each.critical, each.value) for each in certificate.extensions if each.oid not in _OWN}
    algorithm = certificate.signature_hash_algorithm
    known = certificate_forms.HASHES.get(
        algorithm.name.upper() if algorithm else "", certificate_forms.HASHES["SHA256"]
    )
    form = certificate_forms.Form(certificate.subject, (above or certificate).subject, validity, known, values)
    return certificates.to_pem(form.signed(None, public, issuer.key if issuer else key))
