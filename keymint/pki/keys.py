# SPDX-License-Identifier: Apache-2.0
"""Keys: private ones minted, stored as PKCS #8 PEM, read back, and compared with certificates; public ones in PEM.

The private keys of a file are also recognised in whatever form other tools write them: PEM, DER, or PKCS #12. A file in
which a key is missed may end where keys must not be; so what cannot be read counts as a key as well.

No error here contains key material, or a message of the library that could contain it.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from types import MappingProxyType

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa

from comarmor.text import did_you_mean, lazy_regex
from keymint.api import KeySpec
from keymint.errors import KeymintError, Origin
from keymint.pki import der, key_encodings

PrivateKey = key_encodings.PrivateKey
PublicKey = key_encodings.PublicKey
public_der = key_encodings.public_der

# Spelled out: no text from a file ever names an attribute of a library.
CURVES: Mapping[str, ec.EllipticCurve] = MappingProxyType(
    {"SECP256R1": ec.SECP256R1(), "SECP384R1": ec.SECP384R1(), "SECP521R1": ec.SECP521R1()}
)
"""Curves by their SEC 2 names."""
_CURVE_ALIASES = {
    "PRIME256V1": "SECP256R1",
    **{f"{prefix}{bits}": f"SECP{bits}R1" for prefix in ("P", "NISTP") for bits in (256, 384, 521)},
}
MIN_RSA_BITS = 2048
"""NIST SP 800-57 part 1, 5.6.2: 112 bits of security."""
MAX_RSA_BITS = 16384
"""OpenSSL verifies no larger ones (OPENSSL_RSA_MAX_MODULUS_BITS)."""
_PUBLIC_EXPONENT = 65537
_MOST = 1 << 16
"""Number of public keys that are remembered."""
_KNOWN: dict[bytes, tuple[bytes, bool]] = {}
"""Public keys in DER, and whether :func:`to_pem` writes the file so, by the digest of the file of the private key."""
_PEM = lazy_regex(rb"-----BEGIN ([A-Z0-9 ]+)-----\n((?:[A-Za-z0-9+/]{1,64}={0,2}\n)+)-----END \1-----\n")
_MARKS = (b"PRIVATE KEY-----", b"-----BEGIN PKCS12-----")
_BLOCK = lazy_regex(rb"-----BEGIN ([A-Z0-9 ]*PRIVATE KEY|PKCS12)-----.*?-----END \1-----", re.DOTALL)
_LABEL = lazy_regex(rb"-----BEGIN ([^-\r\n]*)-----")
_PUBLIC = frozenset((b"CERTIFICATE", b"CERTIFICATE REQUEST", b"NEW CERTIFICATE REQUEST", b"X509 CRL", b"PUBLIC KEY"))
"""Labels of PEM for what is not secret (RFC 7468)."""
_LENGTH = rb"(?:[\x00-\x80]|\x81.|\x82..|\x83...|\x84....)"
_PKCS12 = lazy_regex(
    rb"\x30" + _LENGTH + rb"\x02\x01\x03\x30" + _LENGTH + rb"\x06\x09\x2a\x86\x48\x86\xf7\x0d\x01\x07[\x01\x02]",
    re.DOTALL,
)
"""How a PFX begins (RFC 7292, section 4): version 3, and content that is data or signed data; BER, as some write it."""
_SEQUENCE = b"\x30"
_CLOSED = frozenset((b"PKCS12", b"OPENSSH PRIVATE KEY"))
"""Labels of PEM whose content is not looked into."""


def curve_name(text: str, where: Origin | None = None) -> str:
    """Return the name of a curve as a key of :data:`CURVES`; ``prime256v1`` and ``P-256`` are SECP256R1.

    Raises:
        KeymintError: the curve is not known; says which is near.
    """
    plain = text.replace("-", "").replace("_", "").replace(" ", "").upper()
    name = _CURVE_ALIASES.get(plain, plain)
    if name in CURVES:
        return name
    help_ = did_you_mean(plain, CURVES, f"known are {', '.join(CURVES)}")
    raise KeymintError(f"{text!r} is not a supported curve", where=where, help=help_, code="key-type-unknown")


def generate(spec: KeySpec, where: Origin | None = None) -> PrivateKey:
    """Return a new private key.

    Args:
        spec: algorithm, and curve or size.
        where: its origin, for messages.

    Raises:
        KeymintError: the algorithm, the curve or the size is not supported.
    """
    curve = _curve(spec, where)
    return ec.generate_private_key(curve) if curve else rsa.generate_private_key(_PUBLIC_EXPONENT, spec.size)


def is_in_memory(key: PrivateKey) -> bool:
    """Return whether a private key is the library's own, not one in a token."""
    return type(key).__module__.startswith("cryptography.")


_known_ecdsa: dict[str, ec.ECDSA] = {}
"""By the hash algorithm: to make one takes a twentieth of a signature."""


class _Ecdsa(ec.ECDSA):
    """ECDSA as in FIPS 186-5, 6.4, with a random number for each signature.

    The class above loads all ciphers, to find out whether that number can be derived from what is signed.

    Args:
        digest: the hash algorithm.
    """

    def __init__(self, digest: hashes.HashAlgorithm) -> None:
        self._digest = digest

    @property
    def algorithm(self) -> hashes.HashAlgorithm:
        return self._digest

    @property
    def deterministic_signing(self) -> bool:
        return False


def _ecdsa(digest: hashes.HashAlgorithm) -> ec.ECDSA:
    return _known_ecdsa.get(digest.name) or _known_ecdsa.setdefault(digest.name, _Ecdsa(digest))


def signature_over(data: bytes, key: PrivateKey, digest: hashes.HashAlgorithm) -> bytes:
    """Return the signature of a key: ECDSA, or RSA with PKCS #1 v1.5."""
    if isinstance(key, ec.EllipticCurvePrivateKey):
        return key.sign(data, _ecdsa(digest))
    return key.sign(data, padding.PKCS1v15(), digest)


def verifies(signature: bytes, data: bytes, key: PublicKey, digest: hashes.HashAlgorithm) -> bool:
    """Return whether a signature over some data was made by the key of :func:`signature_over` with this public half."""
    try:
        if isinstance(key, ec.EllipticCurvePublicKey):
            key.verify(signature, data, _ecdsa(digest))
        else:
            key.verify(signature, data, padding.PKCS1v15(), digest)
    except InvalidSignature:
        return False
    return True


def kind_of(key: PrivateKey | PublicKey) -> KeySpec:
    """Return the algorithm, and the curve or size, of a key; the curve need not be one of :data:`CURVES`."""
    if isinstance(key, rsa.RSAPrivateKey | rsa.RSAPublicKey):
        return KeySpec("rsa", size=key.key_size)
    name = key.curve.name
    return KeySpec("ec", curve=name.upper() if name.upper() in CURVES else name)


def fits(key: PrivateKey | PublicKey, spec: KeySpec) -> bool:
    """Return whether a key has the algorithm and the curve or size of a specification."""
    curve, found = _curve(spec, None), kind_of(key)
    return found.size == spec.size if curve is None else found.curve == curve.name.upper()


def key_description(spec: KeySpec) -> str:
    """Return a kind of key as messages name it."""
    return f"an EC key on {spec.curve}" if spec.algorithm == "ec" else f"an RSA key of {spec.size} bits"


def to_pem(key: PrivateKey, password: bytes | None = None) -> bytes:
    """Return a private key as PKCS #8 PEM, encrypted (PBES2, AES-256) if a password is given."""
    pem = key_encodings.private_pem(key, password)
    if not password:
        _remember(pem, key.public_key(), canonical=True)
    return pem


def from_pem(pem: bytes, password: bytes | None = None, where: Origin | None = None) -> PrivateKey:
    """Return the private key of a PEM file.

    Args:
        pem: the file's bytes.
        password: password of an encrypted key; None for an unencrypted one.
        where: the file, for messages.

    Raises:
        KeymintError: not a private key, an unsupported kind of key, or a missing or wrong password.
    """
    encrypted = is_encrypted(pem)
    if encrypted and not password:
        message = "the private key is encrypted and no password is given"
        help_ = "set the environment variable that password_env names"
        raise KeymintError(message, where=where, help=help_, code="key-password")
    try:
        # The library rejects a password for an unencrypted key; for the user that is not an error.
        key = key_encodings.load_private_pem(pem, password if encrypted else None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, PrivateKey):
        is_locked = encrypted and key is None
        raise KeymintError(
            "the password of the private key is wrong, or its file is damaged"
            if is_locked
            else "not a private key in PEM, a damaged one, or one that is neither EC nor RSA",
            where=where,
            help="restore the file from a backup",
            code="key-password" if is_locked else "key-invalid",
        )
    return key


def public_of(pem: bytes, password: bytes | None = None, where: Origin | None = None) -> PublicKey:
    """Return the public key of the PEM file of a private key; errors as :func:`from_pem`.

    It is remembered by the digest of the file, so that a file is parsed once and no private key is kept.
    """
    if is_encrypted(pem):
        return from_pem(pem, password, where).public_key()
    return key_encodings.load_public_der(_known(pem, where)[0])


def _known(pem: bytes, where: Origin | None = None) -> tuple[bytes, bool]:
    """Return what is remembered of an unencrypted key, see :data:`_KNOWN`; one that is not known is read first."""
    digest = hashlib.sha256(pem).digest()
    if digest not in _KNOWN:
        key = from_pem(pem, None, where)
        _remember(pem, key.public_key(), canonical=to_pem(key) == pem)
    return _KNOWN[digest]


def _remember(pem: bytes, key: PublicKey, *, canonical: bool) -> None:
    if len(_KNOWN) >= _MOST:
        _KNOWN.clear()
    _KNOWN[hashlib.sha256(pem).digest()] = public_der(key), canonical


def matches(key: PrivateKey | PublicKey, certificate: x509.Certificate) -> bool:
    """Return whether a key belongs to a certificate."""
    return (key if isinstance(key, PublicKey) else key.public_key()) == certificate.public_key()


def fingerprint(key: PrivateKey | PublicKey) -> str:
    """Return the SHA-256, in hex, of the public key of a pair (SubjectPublicKeyInfo in DER; RFC 5280, 4.1.2.7)."""
    return hashlib.sha256(public_der(key if isinstance(key, PublicKey) else key.public_key())).hexdigest()


def public_der_of_file(pem: bytes) -> bytes:
    """Return the public half of the key in the PEM file of an unencrypted private key, as :func:`public_der`."""
    return _known(pem)[0]


def fingerprint_of_file(pem: bytes) -> str:
    """Return the fingerprint of the key in the PEM file of an unencrypted private key; errors as :func:`from_pem`."""
    return hashlib.sha256(_known(pem)[0]).hexdigest()


def is_canonical(pem: bytes) -> bool:
    """Return whether a key file is exactly what :func:`to_pem` writes for its key.

    Any changed byte of a canonical file makes this False, or makes :func:`from_pem` or :func:`matches` fail. Of an
    encrypted key (its salt is random) the PEM frame is compared.
    """
    try:
        if not is_encrypted(pem):
            return _known(pem)[1]
        frame = _PEM.fullmatch(pem)
        return frame is not None and der.base64_lines(base64.b64decode(frame[2])) == frame[2]
    except (KeymintError, binascii.Error):
        return False


def is_encrypted(pem: bytes) -> bool:
    """Return whether the private key in a PEM file is encrypted (RFC 7468, section 11; RFC 1421, 4.6.1.1)."""
    return b"-----BEGIN ENCRYPTED PRIVATE KEY-----" in pem or b"Proc-Type: 4,ENCRYPTED" in pem


def _curve(spec: KeySpec, where: Origin | None) -> ec.EllipticCurve | None:
    """Return the curve of an EC key, or None for an RSA key.

    Raises:
        KeymintError: the algorithm is neither, the curve is not known, or an RSA key would be too small or too large.
    """
    algorithm = spec.algorithm.lower()
    if algorithm == "ec":
        return CURVES[curve_name(spec.curve, where)]
    if algorithm != "rsa":
        message = f"{spec.algorithm!r} is not a supported key algorithm"
        help_ = "known are ec (with a curve) and rsa (with a size)"
        raise KeymintError(message, where=where, help=help_, code="key-type-unknown")
    if not MIN_RSA_BITS <= spec.size <= MAX_RSA_BITS:
        message = f"an RSA key of {spec.size} bits is not between {MIN_RSA_BITS} and {MAX_RSA_BITS}"
        raise KeymintError(message, where=where, help="2048 is what every transport accepts", code="key-type-unknown")
    return None


# -- public keys -----------------------------------------------------------------------------------------------------


def public_from_pem(pem: bytes, where: Origin | None = None) -> PublicKey:
    """Return the public key of a PEM text, SubjectPublicKeyInfo (RFC 7468, 13): its private key is elsewhere.

    Args:
        pem: the text, with one public key.
        where: its place, for messages.

    Raises:
        KeymintError: not a public key, or one that is neither EC nor RSA.
    """
    from cryptography.hazmat.primitives.serialization import load_pem_public_key  # noqa: PLC0415 - few runs need it

    try:
        key = load_pem_public_key(pem)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, PublicKey):
        message = "not an EC or RSA public key in PEM (SubjectPublicKeyInfo), or a damaged one"
        help_ = "restore it from version control, or sign a new request of the machine that has the private key"
        raise KeymintError(message, where=where, help=help_, code="public-key-invalid")
    return key


def public_to_pem(key: PublicKey) -> bytes:
    """Return a public key as PEM; equal keys give equal bytes."""
    return der.pem(b"PUBLIC KEY", public_der(key))


# -- the files of other tools -----------------------------------------------------------------------------------------


def has_private_key(content: bytes) -> bool:
    """Tell whether a file has a private key of any kind, or may have one."""
    return any(mark in content for mark in _MARKS) or (content[:1] == _SEQUENCE and any(True for _ in _each(content)))


def is_all_public(content: bytes) -> bool:
    """Tell whether a file only has what everybody may read, in PEM: certificates, requests, lists, public keys."""
    labels = set(_LABEL.findall(content))
    return bool(labels) and labels <= _PUBLIC


def private_keys(content: bytes) -> tuple[tuple[PublicKey, ...], bool]:
    """Return the private keys of a file; a damaged one has none.

    Returns:
        The public keys of those that are EC or RSA keys, and whether there are others that cannot be read: they are
        encrypted, or in a PKCS #12 or OpenSSH file.
    """
    found = tuple(_each(content))
    return tuple(each.public_key() for each in found if isinstance(each, PrivateKey)), None in found


def pem_of(content: bytes, public: PublicKey) -> bytes:
    """Return one of the private keys of a file in PEM: the file itself if Keymint reads that key from it.

    Args:
        content: the file.
        public: the public key of the private key, one of those that :func:`private_keys` returns.
    """
    with suppress(KeymintError):
        if public_of(content) == public:
            return content
    found = (each for each in _each(content) if isinstance(each, PrivateKey))
    return next(to_pem(each) for each in found if each.public_key() == public)


def _each(content: bytes) -> Iterator[object | None]:
    """Yield the private keys of a file; None for one that cannot be read."""
    if any(mark in content for mark in _MARKS):
        for block in _BLOCK.finditer(content):
            if block[1] in _CLOSED:
                yield None
            else:
                yield from _loaded(block[0], key_encodings.load_private_pem)
    elif _PKCS12.match(content):
        yield None
    elif content.startswith(_SEQUENCE):
        from cryptography.hazmat.primitives.serialization import load_der_private_key  # noqa: PLC0415 - few runs need it

        with suppress(ValueError):
            yield from _loaded(der.first_element(content), load_der_private_key)


def _loaded(encoded: bytes, load: Callable[[bytes, None], object]) -> Iterator[object | None]:
    try:
        yield load(encoded, None)
    except (TypeError, UnsupportedAlgorithm):  # the library has a TypeError for a key that is encrypted
        yield None
    except ValueError:
        if b"ENCRYPTED" in encoded:
            yield None
