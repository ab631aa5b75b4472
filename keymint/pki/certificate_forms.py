# SPDX-License-Identifier: Apache-2.0
"""The fields of a certificate to issue: its specification, the defaults of its role, and the limits of its issuer."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache
from types import MappingProxyType

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.x509.oid import ExtendedKeyUsageOID, ExtensionOID

from comarmor.text import quote
from comarmor.values import Data, replace
from keymint.api import CertificateSpec, Validity
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import der, distinguished_names, extensions, keys
from keymint.pki.distinguished_names import to_text

Hash = hashes.SHA256 | hashes.SHA384 | hashes.SHA512
HASHES: Mapping[str, Hash] = MappingProxyType(
    {"SHA256": hashes.SHA256(), "SHA384": hashes.SHA384(), "SHA512": hashes.SHA512()}
)
"""Hash algorithms of certificates. The others than SHA256 are for keys that only some software accepts."""
_MAX_SERIAL = 1 << 159
"""Exclusive: 20 octets, positive (RFC 5280, 4.1.2.2)."""
_FIRST_YEAR, _FIRST_LONG_YEAR = 1950, 2050
_TRUE = der.tlv(der.BOOLEAN, b"\xff")
_OIDS = x509.SignatureAlgorithmOID
_ALGORITHMS = {
    ("ec", "sha256"): der.tlv(der.SEQUENCE, der.oid(_OIDS.ECDSA_WITH_SHA256.dotted_string)),
    ("ec", "sha384"): der.tlv(der.SEQUENCE, der.oid(_OIDS.ECDSA_WITH_SHA384.dotted_string)),
    ("ec", "sha512"): der.tlv(der.SEQUENCE, der.oid(_OIDS.ECDSA_WITH_SHA512.dotted_string)),
    ("rsa", "sha256"): der.tlv(der.SEQUENCE, der.oid(_OIDS.RSA_WITH_SHA256.dotted_string), der.tlv(der.NULL)),
    ("rsa", "sha384"): der.tlv(der.SEQUENCE, der.oid(_OIDS.RSA_WITH_SHA384.dotted_string), der.tlv(der.NULL)),
    ("rsa", "sha512"): der.tlv(der.SEQUENCE, der.oid(_OIDS.RSA_WITH_SHA512.dotted_string), der.tlv(der.NULL)),
}
"""AlgorithmIdentifiers of signatures by the kind of key and the hash (RFC 5758, 3.2; RFC 4055, 5)."""
_SIGNS_DOCUMENTS = (ExtendedKeyUsageOID.EMAIL_PROTECTION, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE)
"""Extended key usages with which OpenSSL lets a key sign S/MIME (purpose smimesign)."""


_Values = dict[x509.ObjectIdentifier, tuple[bool, x509.ExtensionType]]


class Form(Data):
    """All fields of a certificate to issue, except its serial number; and a warning if its validity was cut."""

    subject: x509.Name
    issuer: x509.Name
    validity: Validity
    hash_algorithm: Hash
    extensions: _Values
    diagnostics: tuple[Diagnostic, ...] = ()

    def signed(self, serial: int | None, public_key: keys.PublicKey, signing_key: keys.PrivateKey) -> x509.Certificate:
        """Return the certificate.

        Args:
            serial: its serial number; None for a random one.
            public_key: the key to certify.
            signing_key: the issuer's private key.
        """
        number = x509.random_serial_number() if serial is None else serial
        algorithm = signature_algorithm(signing_key, self.hash_algorithm)
        period = map(_time, (self.validity.not_before, self.validity.not_after))
        fields = (
            der.tlv(der.CONTEXT_0, der.tlv(der.INTEGER, b"\2")),  # version 3
            _serial(number),
            algorithm,
            self.issuer.public_bytes(),
            der.tlv(der.SEQUENCE, *period),
            self.subject.public_bytes(),
            keys.public_der(public_key),
            der.tlv(der.CONTEXT_3, der.tlv(der.SEQUENCE, *map(_extension, self.extensions.items()))),
        )
        body = der.tlv(der.SEQUENCE, *fields if self.extensions else fields[:-1])
        return x509.load_der_x509_certificate(_with_signature(body, algorithm, signing_key, self.hash_algorithm))


def signature_algorithm(key: keys.PrivateKey | keys.PublicKey, digest: hashes.HashAlgorithm) -> bytes:
    """Return the AlgorithmIdentifier, in DER, of a signature of a key: see :func:`keymint.pki.keys.signature_over`.

    Args:
        key: the key, or its public half.
        digest: one of :data:`HASHES`.
    """
    return _ALGORITHMS[keys.kind_of(key).algorithm, digest.name]


def _time(moment: datetime) -> bytes:
    """Return a time as it is encoded in a certificate (RFC 5280, 4.1.2.5)."""
    if moment.year < _FIRST_YEAR:
        raise ValueError(f"{moment:%Y} is before {_FIRST_YEAR}")
    if moment.year < _FIRST_LONG_YEAR:
        return der.tlv(der.UTC_TIME, f"{moment:%y%m%d%H%M%SZ}".encode())
    return der.tlv(der.GENERALIZED_TIME, f"{moment:%Y%m%d%H%M%SZ}".encode())


def _extension(extension: tuple[x509.ObjectIdentifier, tuple[bool, x509.ExtensionType]]) -> bytes:
    """Return an extension in DER (RFC 5280, 4.1); that it is not critical is the default, which DER leaves out."""
    oid, (critical, value) = extension
    encoded = der.tlv(der.OCTET_STRING, value.public_bytes())
    return der.tlv(der.SEQUENCE, der.oid(oid.dotted_string), *[_TRUE] * critical, encoded)


def _serial(number: int) -> bytes:
    return der.tlv(der.INTEGER, number.to_bytes(number.bit_length() // 8 + 1, "big"))


def _with_signature(body: bytes, algorithm: bytes, key: keys.PrivateKey, digest: hashes.HashAlgorithm) -> bytes:
    """Return a certificate in DER, of the TBSCertificate and the AlgorithmIdentifier of its signature."""
    signature = keys.signature_over(body, key, digest)
    return der.tlv(der.SEQUENCE, body, algorithm, der.tlv(der.BIT_STRING, b"\0", signature))


def form(
    spec: CertificateSpec, public_key: keys.PublicKey, issuer: x509.Certificate | None, *, authority: bool
) -> Form:
    """Return the fields of a certificate; its validity is cut to the issuer's.

    Raises:
        KeymintError: the specification cannot be issued; with its origin.
    """
    if spec.serial is not None and not 0 < spec.serial < _MAX_SERIAL:
        message = f"the serial number {spec.serial} is not between 1 and 2^159 - 1 (RFC 5280, 4.1.2.2)"
        raise KeymintError(message, where=spec.origin, help="leave it empty for a random one", code="serial-invalid")
    hash_algorithm = HASHES.get(spec.hash_algorithm.upper().replace("-", ""))
    if hash_algorithm is None:
        message = f"{spec.hash_algorithm!r} is not a supported hash algorithm"
        raise KeymintError(message, where=spec.origin, help=f"known are {', '.join(HASHES)}", code="hash-unknown")
    if issuer is not None:
        _check_issuer(issuer, spec.origin, authority=authority)
    subject = distinguished_names.parse(spec.subject_name, spec.origin)
    validity, diagnostics = _clamp(spec, issuer)
    return Form(
        subject=subject,
        issuer=subject if issuer is None else issuer.subject,
        validity=validity,
        hash_algorithm=hash_algorithm,
        extensions=_extensions(spec, extensions.Context(public_key, issuer), authority=authority),
        diagnostics=diagnostics,
    )


class CommonParts(Data):
    """What the DER of a certificate shares with one for another name and key.

    Attributes:
        version: its version.
        algorithm: the algorithm of its signature.
        middle: this with issuer and validity.
        before: the extensions before the identifier of the key.
        after: the extensions after it.
        digest: the hash algorithm of its signature.
    """

    version: bytes
    algorithm: bytes
    middle: bytes
    before: bytes
    after: bytes
    digest: hashes.HashAlgorithm

    @classmethod
    def of(cls, certificate: x509.Certificate) -> CommonParts | None:
        """Return the parts of a certificate; None if the place of the identifier is not certain.

        They are derived from what was written. The identifier of the key must be its hash, as it is by default.
        """
        fields = der.elements(der.single(certificate.tbs_certificate_bytes, der.SEQUENCE))
        identifier = extensions.value(certificate, x509.SubjectKeyIdentifier)
        own, digest = key_identifier(fields[6]), certificate.signature_hash_algorithm
        before, _, after = fields[-1].partition(own)
        if identifier is None or identifier.digest != own or own in after or digest is None:
            return None
        return cls(fields[0], fields[2], b"".join(fields[2:5]), before, after, digest)

    def is_same(self, other: CommonParts | None) -> bool:
        """Tell whether these are the parts of another certificate, too."""
        return other is not None and replace(self, digest=other.digest) == other

    def fill(self, subject: bytes, public: bytes, signer: keys.PrivateKey) -> tuple[bytes, int]:
        """Return a certificate in DER, as the library would write it, at a third of the cost; and its serial number.

        Args:
            subject: the subject, in DER.
            public: the key to certify, in DER.
            signer: the issuer's private key.
        """
        serial = x509.random_serial_number()
        body = der.tlv(der.SEQUENCE, self.version, _serial(serial), self._after_serial(subject, public))
        return _with_signature(body, self.algorithm, signer, self.digest), serial

    def are_in(self, content: bytes, subject: bytes, public: bytes, issuer: keys.PublicKey) -> bool:
        """Return whether a certificate has these parts, a serial number, what is given, and nothing else.

        Args:
            content: the certificate in DER.
            subject: the subject that it must have, in DER.
            public: the key that it must certify, in DER.
            issuer: the key that must have signed it.

        Raises:
            ValueError: it has another structure.
        """
        body, algorithm, signature = der.elements(der.single(content, der.SEQUENCE))
        fields, rest = der.single(body, der.SEQUENCE), self._after_serial(subject, public)
        serial = fields.removeprefix(self.version).removesuffix(rest)
        number = int.from_bytes(der.single(serial, der.INTEGER), "big", signed=True)
        value = der.single(signature, der.BIT_STRING)
        return (
            (algorithm, fields) == (self.algorithm, b"".join((self.version, serial, rest)))
            and 0 < number < _MAX_SERIAL
            and value[0] == 0
            and keys.verifies(value[1:], body, issuer, self.digest)
        )

    def _after_serial(self, subject: bytes, public: bytes) -> bytes:
        return b"".join((self.middle, subject, public, self.before, key_identifier(public), self.after))


@lru_cache(maxsize=1024)
def key_identifier(public: bytes) -> bytes:
    """Return the identifier that a key has by default: the SHA-1 of its bits (RFC 5280, 4.2.1.2).

    Args:
        public: the key in DER, SubjectPublicKeyInfo.
    """
    _, bits = der.elements(der.single(public, der.SEQUENCE))
    return hashlib.sha1(der.single(bits, der.BIT_STRING)[1:], usedforsecurity=False).digest()


def validity_within(validity: Validity, issuer: x509.Certificate | None) -> Validity:
    """Return a validity, cut to the issuer's and to whole seconds (RFC 5280, 4.1.2.5); it may be empty."""
    first = validity.not_before.astimezone(UTC).replace(microsecond=0)
    last = validity.not_after.astimezone(UTC).replace(microsecond=0)
    if issuer is None:
        return Validity(first, last)
    return Validity(max(first, issuer.not_valid_before_utc), min(last, issuer.not_valid_after_utc))


def checked_validity(validity: Validity, issuer: x509.Certificate | None, where: Origin) -> Validity:
    """Return a validity that :func:`validity_within` cut.

    Raises:
        KeymintError: it is empty.
    """
    clamped = validity_within(validity, issuer)
    if clamped.not_before >= clamped.not_after:
        beyond = f", within the validity of its issuer {to_text(issuer.subject)!r}" if issuer is not None else ""
        message = f"the validity is empty: {_period(validity_within(validity, None))}{beyond}"
        raise KeymintError(message, where=where, help="change its dates, or renew the issuer", code="validity-empty")
    return clamped


def _clamp(spec: CertificateSpec, issuer: x509.Certificate | None) -> tuple[Validity, tuple[Diagnostic, ...]]:
    """Return the validity of a certificate, and a warning if it is not the one that was requested."""
    requested, clamped = validity_within(spec.validity, None), checked_validity(spec.validity, issuer, spec.origin)
    if clamped == requested:
        return clamped, ()
    warning = Diagnostic.warning(
        "validity-clamped",
        f"the validity of the certificate, {_period(requested)}, is cut to its issuer's: {_period(clamped)}",
        spec.validity.origin or spec.origin,
        "keep it within the issuer's validity, or renew the issuer",
    )
    return clamped, (warning,)


def _period(validity: Validity) -> str:
    return f"{validity.not_before:%Y-%m-%dT%H:%M:%SZ} to {validity.not_after:%Y-%m-%dT%H:%M:%SZ}"


def _check_issuer(issuer: x509.Certificate, where: Origin, *, authority: bool) -> None:
    """Raise an error for an issuer that must not issue certificates (RFC 5280, 4.2.1.3 and 4.2.1.9)."""
    problem = extensions.not_an_authority(issuer)
    constraints = extensions.value(issuer, x509.BasicConstraints)
    if authority and constraints is not None and constraints.path_length == 0:
        problem = problem or "it has pathlen:0, so it may not issue authorities"
    if problem:
        message = f"the issuer {to_text(issuer.subject)!r} cannot issue it: {problem}"
        help_ = "name another issuer, or change the extensions of this one"
        raise KeymintError(message, where=where, help=help_, code="issuer-invalid")


def _extensions(spec: CertificateSpec, context: extensions.Context, *, authority: bool) -> _Values:
    """Return the role's defaults, replaced by the extensions of the specification."""
    values = defaults(context, authority=authority)
    replaced: set[x509.ObjectIdentifier] = set()
    for extension in spec.extensions:
        oid, critical, value = extensions.parse(extension, context)
        if oid in replaced:
            raise KeymintError(
                f"the extension {extension.name} occurs twice", where=extension.origin, code="extension-invalid"
            )
        replaced.add(oid)
        if value is None:
            values.pop(oid, None)
        else:
            values[oid] = (critical, value)
        if problem := _conflict(value, critical, authority=authority):
            message = f"{extension.name} = {quote(extension.value, 80)} {problem}"
            help_ = "leave it out, or correct it" if authority else "leave it out for the default"
            raise KeymintError(message, where=extension.origin, help=help_, code="extension-conflict")
    return values


def defaults(context: extensions.Context, *, authority: bool) -> _Values:
    """Return the extensions of an authority or an identity, by OID: whether it is critical, and the value."""
    values: _Values = {
        ExtensionOID.BASIC_CONSTRAINTS: (True, x509.BasicConstraints(authority, None)),
        ExtensionOID.KEY_USAGE: (True, _AUTHORITY_USAGE if authority else _IDENTITY_USAGE),
    }
    if not authority:
        values[ExtensionOID.EXTENDED_KEY_USAGE] = (False, _IDENTITY_EXTENDED_USAGE)
    identifier = x509.SubjectKeyIdentifier.from_public_key(context.public_key)
    values[ExtensionOID.SUBJECT_KEY_IDENTIFIER] = (False, identifier)
    if context.issuer is not None:
        issuer_identifier = extensions.authority_key_identifier(context.issuer)
        values[ExtensionOID.AUTHORITY_KEY_IDENTIFIER] = (False, issuer_identifier)
    return values


_AUTHORITY_USAGE = extensions.key_usage("digitalSignature", "keyCertSign", "cRLSign")
_IDENTITY_USAGE = extensions.key_usage("digitalSignature")
_IDENTITY_EXTENDED_USAGE = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])


def _conflict(value: x509.ExtensionType | None, critical: bool, *, authority: bool) -> str:
    """Return why a certificate of this role must not have an extension, or an empty string."""
    match value:
        case x509.ExtendedKeyUsage() if not authority and any(each in value for each in _SIGNS_DOCUMENTS):
            return "would let an identity sign its own permissions (emailProtection, anyExtendedKeyUsage)"
        case x509.BasicConstraints() if not authority and value.ca:
            return "would make an identity an authority"
        case x509.KeyUsage() if not authority and value.key_cert_sign:
            return "would let an identity issue certificates (keyCertSign)"
        case x509.BasicConstraints() if authority and not (value.ca and critical):
            return "must be critical and CA:TRUE for an authority (RFC 5280, 4.2.1.9)"
        case x509.KeyUsage() if authority and not value.key_cert_sign:
            return "must have keyCertSign for an authority (RFC 5280, 4.2.1.3)"
        case _:
            return ""
