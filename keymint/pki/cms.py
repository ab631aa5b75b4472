# SPDX-License-Identifier: Apache-2.0
"""Detached CMS signatures (RFC 5652): one signer, its certificate inside, SHA-2, signed attributes.

They are made with SHA-256, and verified also with SHA-384 and SHA-512, which openssl supports: every field is either
compared with its one legal value, or covered by the signature.
"""

from __future__ import annotations

import functools
import hashlib
from typing import cast

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from comarmor.values import Data
from keymint.pki import der
from keymint.pki.keys import PrivateKey, PublicKey, signature_over, verifies

_SIGNED_DATA = der.oid("1.2.840.113549.1.7.2")
_DATA = der.oid("1.2.840.113549.1.7.1")
_CONTENT_TYPE = der.oid("1.2.840.113549.1.9.3")
_MESSAGE_DIGEST = der.oid("1.2.840.113549.1.9.4")
_VERSION_1 = der.tlv(der.INTEGER, b"\1")


def _algorithm(dotted: str) -> tuple[bytes, bytes]:
    """Return both encodings of an AlgorithmIdentifier: parameters NULL, and absent (RFC 5754, section 2)."""
    identifier = der.oid(dotted)
    return der.tlv(der.SEQUENCE, identifier, der.tlv(der.NULL)), der.tlv(der.SEQUENCE, identifier)


class _Digest(Data):
    """A digest, and the encodings of its AlgorithmIdentifier alone and with ECDSA."""

    algorithm: hashes.SHA256 | hashes.SHA384 | hashes.SHA512
    encodings: tuple[bytes, bytes]
    with_ecdsa: tuple[bytes, bytes]


_DIGESTS = {
    "sha256": _Digest(hashes.SHA256(), _algorithm("2.16.840.1.101.3.4.2.1"), _algorithm("1.2.840.10045.4.3.2")),
    "sha384": _Digest(hashes.SHA384(), _algorithm("2.16.840.1.101.3.4.2.2"), _algorithm("1.2.840.10045.4.3.3")),
    "sha512": _Digest(hashes.SHA512(), _algorithm("2.16.840.1.101.3.4.2.3"), _algorithm("1.2.840.10045.4.3.4")),
}
"""Collision-resistant digests: not SHA-1, although vendors accept it."""
# RSA only by rsaEncryption (RFC 3370, 3.2): sha256WithRSAEncryption differs from it by one altered byte.
_RSA = _algorithm("1.2.840.113549.1.1.1")


class Signature(Data):
    """The parts of a signature.

    Attributes:
        certificate: the embedded certificate of the signer, DER.
        digest: the digest algorithm: ``sha256``, ``sha384`` or ``sha512``.
        issuer_and_serial: the identifier of the signer's certificate, DER.
        attributes: signed attributes in their signed form (a SET), DER.
        algorithm: signature algorithm, DER.
        value: the signature.
    """

    certificate: bytes
    digest: str
    issuer_and_serial: bytes
    attributes: bytes
    algorithm: bytes
    value: bytes


def sign(text: bytes, certificate: x509.Certificate, key: PrivateKey) -> bytes:
    """Return a detached signature over a text, with SHA-256, in DER.

    It has what the library writes, but for the time, which it takes from the clock and nobody judges. The library's own
    signatures take four times as long, and the package ``email``.
    """
    before, head, attributes = _common_parts(certificate)
    hashed, digest = hashlib.sha256(text).digest(), _DIGESTS["sha256"]
    value = signature_over(der.tlv(der.SET, attributes, hashed), key, digest.algorithm)
    algorithm = digest.with_ecdsa[1] if isinstance(key, ec.EllipticCurvePrivateKey) else _RSA[0]
    own = der.tlv(der.CONTEXT_0, attributes, hashed), algorithm, der.tlv(der.OCTET_STRING, value)
    signed = der.tlv(der.SEQUENCE, before, der.tlv(der.SET, der.tlv(der.SEQUENCE, head, *own)))
    return der.tlv(der.SEQUENCE, _SIGNED_DATA, der.tlv(der.CONTEXT_0, signed))


@functools.lru_cache(maxsize=16)
def _common_parts(certificate: x509.Certificate) -> tuple[bytes, bytes, bytes]:
    """Return what all signatures with a certificate have before the signer, in it, and in its attributes, in DER.

    The digest of the text comes after the last.
    """
    content, named = identity_of(certificate)
    digest, unknown = _DIGESTS["sha256"], bytes(hashlib.sha256().digest_size)
    body = der.tlv(der.SET, digest.encodings[0]), der.tlv(der.SEQUENCE, _DATA), der.tlv(der.CONTEXT_0, content)
    # Sorted by their encoding, as a SET of DER is.
    pairs = (_CONTENT_TYPE, _DATA), (_MESSAGE_DIGEST, der.tlv(der.OCTET_STRING, unknown))
    attributes = b"".join(der.tlv(der.SEQUENCE, kind, der.tlv(der.SET, each)) for kind, each in pairs)
    before, head = (_VERSION_1, *body), (_VERSION_1, named, digest.encodings[0])
    return b"".join(before), b"".join(head), attributes.removesuffix(unknown)


def parse(signature: bytes) -> Signature:
    """Return the parts of a signature.

    Raises:
        ValueError: not in the one accepted form; with the reason.
    """
    content_type, explicit = _parts(_inside(signature, der.SEQUENCE, "CMS"), 2, "CMS content")
    signed_data = _inside(der.single(explicit, der.CONTEXT_0), der.SEQUENCE, "signed data")
    version, digests, content, certificates, signers = _parts(signed_data, 5, "signed data with one certificate")
    certificate = der.single(certificates, der.CONTEXT_0)
    _inside(certificate, der.SEQUENCE, "one certificate in it, the signer's")
    signer = _inside(der.single(signers, der.SET), der.SEQUENCE, "one signer")
    signer_version, issuer_and_serial, digest, attributes, algorithm, value = _parts(
        signer, 6, "a signer with signed attributes, and no unsigned ones"
    )
    digest_name = next((name for name, known in _DIGESTS.items() if digest in known.encodings), None)
    if digest_name is None or der.single(digests, der.SET) not in _DIGESTS[digest_name].encodings:
        raise ValueError("its digest is not one of SHA-256, SHA-384 and SHA-512")
    if content != der.tlv(der.SEQUENCE, _DATA):
        raise ValueError("it contains the content, expected a detached signature")
    if content_type != _SIGNED_DATA or not version == signer_version == _VERSION_1:
        raise ValueError("it is not signed data of version 1")
    return Signature(
        certificate=certificate,
        digest=digest_name,
        issuer_and_serial=issuer_and_serial,
        attributes=der.tlv(der.SET, der.single(attributes, der.CONTEXT_0)),
        algorithm=algorithm,
        value=der.single(value, der.OCTET_STRING),
    )


def verify(signature: Signature, text: bytes, certificate: x509.Certificate) -> bool:
    """Return whether a signature over a text was made with a certificate, which must be the embedded one."""
    is_named = (signature.certificate, signature.issuer_and_serial) == identity_of(certificate)
    if not is_named or not _attributes_match(signature, text):
        return False
    key, digest = certificate.public_key(), _DIGESTS[signature.digest]
    is_ec = isinstance(key, ec.EllipticCurvePublicKey) and signature.algorithm in digest.with_ecdsa
    if not is_ec and not (isinstance(key, rsa.RSAPublicKey) and signature.algorithm in _RSA):
        return False
    return verifies(signature.value, signature.attributes, cast("PublicKey", key), digest.algorithm)


_MOST_FORMS = 64
_forms: dict[tuple[x509.Certificate, str, int], tuple[bytes, bytes, list[bytes]]] = {}
"""The bytes of verified signatures before and after the digest of the text, and around that in the attributes.

By certificate, digest algorithm and length. Only the value follows the bytes after the digest.
"""


def remember(content: bytes, signature: Signature, text: bytes, certificate: x509.Certificate) -> None:
    """Remember the form of a verified signature, so that :func:`has_known_form` recognises it.

    Args:
        content: the signature in DER.
        signature: its parts.
        text: the text that it is over.
        certificate: the certificate that it was verified with.
    """
    hashed = hashlib.new(signature.digest, text).digest()
    before, _, after = content.removesuffix(signature.value).partition(hashed)
    if content.endswith(signature.value) and hashed not in after and len(_forms) < _MOST_FORMS:
        form = before, after, signature.attributes.split(hashed)
        _forms[certificate, signature.digest, len(content)] = form


def has_known_form(content: bytes, digest: str, text: bytes, certificate: x509.Certificate) -> bool:
    """Return whether a signature is right and has every byte of one that was verified, but for digest and value.

    Args:
        content: the signature in DER.
        digest: its digest algorithm.
        text: the text that it is over.
        certificate: the certificate that it must have been made with.
    """
    before, after, attributes = _forms.get((certificate, digest, len(content)), (b"", b"", [b""]))
    hashed = hashlib.new(digest, text).digest()
    end = len(before) + len(hashed) + len(after)
    if not before or content[:end] != hashed.join((before, after)):
        return False
    key = cast("PublicKey", certificate.public_key())
    return verifies(content[end:], hashed.join(attributes), key, _DIGESTS[digest].algorithm)


@functools.lru_cache(maxsize=16)
def identity_of(certificate: x509.Certificate) -> tuple[bytes, bytes]:
    """Return a certificate in DER, and how a signature names it: IssuerAndSerialNumber (RFC 5652, 10.2.4)."""
    fields = der.elements(der.single(certificate.tbs_certificate_bytes, der.SEQUENCE))
    serial, _, issuer = fields[1:4] if fields[0][0] == der.CONTEXT_0 else fields[:3]
    return der.der_of(certificate), der.tlv(der.SEQUENCE, issuer, serial)


def _attributes_match(signature: Signature, text: bytes) -> bool:
    """Compare the content type and the message digest, each present once (RFC 5652, 5.3 and 11)."""
    try:
        attributes = der.elements(der.single(signature.attributes, der.SET))
        pairs = [_parts(der.single(each, der.SEQUENCE), 2, "an attribute") for each in attributes]
    except ValueError:
        return False
    required = {
        _CONTENT_TYPE: der.tlv(der.SET, _DATA),
        _MESSAGE_DIGEST: der.tlv(der.SET, der.tlv(der.OCTET_STRING, hashlib.new(signature.digest, text).digest())),
    }
    return len({kind for kind, _ in pairs}) == len(pairs) and required.items() <= {tuple(pair) for pair in pairs}


def _inside(data: bytes, tag: int, what: str) -> bytes:
    """Return the content of data that must be one element, called ``what`` in messages."""
    try:
        return der.single(data, tag)
    except ValueError as error:
        raise ValueError(f"expected {what}: {error}") from None


def _parts(content: bytes, count: int, what: str) -> list[bytes]:
    """Return the elements of a content, each with its header; there must be ``count`` of them."""
    parsed = der.elements(content)
    if len(parsed) != count:
        raise ValueError(f"expected {what}")
    return parsed
