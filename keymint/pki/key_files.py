# SPDX-License-Identifier: Apache-2.0
"""Recognise the private keys in a file, in whatever form other tools write them: PEM, DER, or PKCS #12.

A file in which a key is missed may end where keys must not be; so what cannot be read counts as a key as well.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization

from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from keymint.errors import KeymintError
from keymint.pki import der, keys
from keymint.pki.keys import PrivateKey, PublicKey

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


@dataclass(frozen=True, slots=True)
class PrivateKeys:
    """The private keys of a file.

    Attributes:
        public: the public keys of those that are EC or RSA keys.
        sealed: there are others that cannot be read: they are encrypted, or in a PKCS #12 or OpenSSH file.
    """

    public: tuple[PublicKey, ...] = ()
    sealed: bool = False


def has_any(content: bytes) -> bool:
    """Tell whether a file has a private key of any kind, or may have one."""
    return any(mark in content for mark in _MARKS) or any(True for _ in _each(content))


def is_public(content: bytes) -> bool:
    """Tell whether a file only has what everybody may read, in PEM: certificates, requests, lists, public keys."""
    labels = set(_LABEL.findall(content))
    return bool(labels) and labels <= _PUBLIC


def private_keys(content: bytes) -> PrivateKeys:
    """Return the private keys of a file; a damaged one has none."""
    found = tuple(_each(content))
    return PrivateKeys(tuple(each.public_key() for each in found if isinstance(each, PrivateKey)), None in found)


def pem_of(content: bytes, public: PublicKey) -> bytes:
    """Return one of the private keys of a file in PEM: the file itself if Keymint reads that key from it.

    Args:
        content: the file.
        public: the public key of the private key, one of :attr:`PrivateKeys.public`.
    """
    with suppress(KeymintError):
        if keys.public_of(content) == public:
            return content
    found = (each for each in _each(content) if isinstance(each, PrivateKey))
    return next(keys.to_pem(each) for each in found if each.public_key() == public)


def _each(content: bytes) -> Iterator[object | None]:
    """Yield the private keys of a file; None for one that cannot be read."""
    if any(mark in content for mark in _MARKS):
        for block in _BLOCK.finditer(content):
            if block[1] in _CLOSED:
                yield None
            else:
                yield from _loaded(block[0], serialization.load_pem_private_key)
    elif _PKCS12.match(content):
        yield None
    elif content.startswith(_SEQUENCE):
        with suppress(ValueError):
            yield from _loaded(der.first_element(content), serialization.load_der_private_key)


def _loaded(encoded: bytes, load: Callable[[bytes, None], object]) -> Iterator[object | None]:
    try:
        yield load(encoded, None)
    except (TypeError, UnsupportedAlgorithm):  # the library has a TypeError for a key that is encrypted
        yield None
    except ValueError:
        if b"ENCRYPTED" in encoded:
            yield None
