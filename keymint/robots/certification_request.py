# SPDX-License-Identifier: Apache-2.0
"""Requests for a certificate: a certification request (PKCS #10, RFC 2986), perhaps signed by the current key as well.

The file is a PEM block ``CERTIFICATE REQUEST``. If an enclave replaces its key, a block ``CMS`` follows (RFC 7468):
a detached signature (RFC 5652) over the first block, by the certificate that the enclave has.

A request carries a public key, which it proves to possess, and a nonce, which the answer repeats. Its name is only
a claim, and says for which enclave somebody asks; extensions are ignored.
"""

from __future__ import annotations

import base64

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.x509.oid import AttributeOID, NameOID

from comarmor.text import lazy_regex, quote
from comarmor.values import Data
from keymint.errors import KeymintError, Origin
from keymint.names import package_name, subject_of
from keymint.pki import certificates, cms, der, keys

MAX_BYTES = 1 << 16
"""Largest request in bytes; one with an RSA key of 16,384 bits and a signature by such a key has about 15,000."""
NONCE_BYTES = 16
_NONCE = lazy_regex(r"[0-9a-f]{32}")
_HASHES = (hashes.SHA256, hashes.SHA384, hashes.SHA512)
_BASE64 = rb"((?:[A-Za-z0-9+/]{1,64}={0,2}\n)+)"
_FILE = lazy_regex(
    rb"(-----BEGIN CERTIFICATE REQUEST-----\n" + _BASE64 + rb"-----END CERTIFICATE REQUEST-----\n)"
    rb"(?:-----BEGIN CMS-----\n" + _BASE64 + rb"-----END CMS-----\n)?"
)
_UNREADABLE = (ValueError, TypeError, UnsupportedAlgorithm, x509.InvalidVersion, x509.AttributeNotFound)


class CertificationRequest(Data):
    """A request whose signatures were verified.

    Attributes:
        common_name: the name that it claims, e.g. ``/robot/talker``; see
            :func:`keymint.pki.distinguished_names.common_name`.
        public_key: the key to certify, PEM (SubjectPublicKeyInfo).
        fingerprint: fingerprint of that key, see :func:`keymint.pki.keys.fingerprint`.
        nonce: 32 hexadecimal digits.
        signer: fingerprint of the other key that signed the request, the enclave's current one; empty if none did.
    """

    common_name: str
    public_key: bytes
    fingerprint: str
    nonce: str
    signer: str = ""


def make(common_name: str, key: keys.PrivateKey, nonce: str, current: certificates.Issuer | None = None) -> bytes:
    """Return the file of a request.

    Args:
        common_name: the enclave's name, at most 64 characters.
        key: the key to certify.
        nonce: 32 hexadecimal digits that were never used before.
        current: the enclave's present certificate and key, if these vouch for a new key.
    """
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    # As in EST (RFC 7030, 3.5), the challenge password (RFC 2985, 5.4.1) ties the request to its answer.
    builder = x509.CertificateSigningRequestBuilder(subject).add_attribute(
        AttributeOID.CHALLENGE_PASSWORD, nonce.encode()
    )
    pem = builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    if current is None:
        return pem
    signature = der.base64_lines(cms.sign(pem, current.certificate, current.key))
    return pem + b"-----BEGIN CMS-----\n" + signature + b"-----END CMS-----\n"


def read(content: bytes, where: Origin) -> CertificationRequest:
    """Return a request, after verifying its signatures.

    Args:
        content: the file.
        where: the file, for messages.

    Raises:
        KeymintError: ``request-invalid``: not exactly one request, or in another form than :func:`make` writes.
            ``request-signature``: a signature is invalid, so it proves no possession of the key. ``key-kind``: neither
            an EC key on a curve of NIST, nor an RSA key of 2048 bits or more.
    """
    match = _FILE.fullmatch(content) if len(content) <= MAX_BYTES else None
    if match is None:
        raise _invalid("is not exactly one certification request in PEM", where)
    block, _, signature = match.groups()
    try:
        csr = x509.load_pem_x509_csr(block)
        signed = csr.is_signature_valid and isinstance(csr.signature_hash_algorithm, _HASHES)
        names = [part.value for part in csr.subject]
        nonce = csr.attributes.get_attribute_for_oid(AttributeOID.CHALLENGE_PASSWORD).value.decode("ascii")
        key: object = csr.public_key()
        canonical = csr.public_bytes(serialization.Encoding.PEM) == block
    except _UNREADABLE:
        raise _invalid("is not a certification request that 'keymint request' wrote, or a damaged one", where) from None
    if not canonical or not csr.subject.get_attributes_for_oid(NameOID.COMMON_NAME) or len(names) != 1:
        raise _invalid("does not have exactly one name, the enclave's", where)
    if not _NONCE.fullmatch(nonce):
        raise _invalid("has no nonce of 32 hexadecimal digits", where)
    claimed = names[0] if isinstance(names[0], str) else ""
    try:
        name = subject_of(package_name(claimed))
    except KeymintError:
        raise _invalid(f"claims the name {quote(claimed, 80)}, which no enclave can have", where) from None
    public = _usable(key, where)
    if not signed:
        raise _unsigned("is not signed by the key that it asks a certificate for", where)
    pem = keys.public_to_pem(public)
    return CertificationRequest(name, pem, keys.fingerprint(public), nonce, _signer(signature, block, where))


def _usable(key: object, where: Origin) -> keys.PublicKey:
    """Return a public key that identities may have."""
    if isinstance(key, keys.PublicKey):
        kind = keys.kind_of(key)
        if kind.curve in keys.CURVES or keys.MIN_RSA_BITS <= kind.size <= keys.MAX_RSA_BITS:
            return key
    message = f"asks for a key that is neither on {', '.join(keys.CURVES)} nor RSA of {keys.MIN_RSA_BITS} bits or more"
    help_ = "make a new request on the robot with 'keymint request'"
    raise KeymintError(message, where=where, help=help_, code="key-kind")


def _signer(signature: bytes | None, block: bytes, where: Origin) -> str:
    """Return the fingerprint of the key that signed a request additionally; empty if none did."""
    if signature is None:
        return ""
    try:
        parsed = cms.parse(_decoded(signature))
        certificate = x509.load_der_x509_certificate(parsed.certificate)
        key = certificates.public_key(certificate)
        verified = cms.verify(parsed, block, certificate)
    except (*_UNREADABLE, KeymintError):
        raise _invalid("has a damaged signature by the enclave's current key", where) from None
    if not verified:
        raise _unsigned("has a signature by another key that is invalid", where)
    return keys.fingerprint(key)


def _decoded(lines: bytes) -> bytes:
    content = base64.b64decode(lines.replace(b"\n", b""), validate=True)
    if der.base64_lines(content) != lines:
        raise ValueError("not canonical")
    return content


def _invalid(message: str, where: Origin) -> KeymintError:
    help_ = "copy the file again, or make it again on the robot with 'keymint request'"
    return KeymintError(message, where=where, help=help_, code="request-invalid")


def _unsigned(message: str, where: Origin) -> KeymintError:
    help_ = "it was altered on its way: compare its fingerprint with the one that the robot shows"
    return KeymintError(message, where=where, help=help_, code="request-signature")
