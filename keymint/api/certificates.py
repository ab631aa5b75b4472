# SPDX-License-Identifier: Apache-2.0
"""Specifications of keys and certificates that a profile or a package requests."""

from __future__ import annotations

from dataclasses import field
from datetime import datetime
from enum import StrEnum

from comarmor.errors import Origin
from comarmor.values import dataclass


@dataclass(frozen=True, slots=True)
class Validity:
    """A period of validity, in UTC, both ends included (RFC 5280, 4.1.2.5).

    Attributes:
        origin: where its end is written, or None.
    """

    not_before: datetime
    not_after: datetime
    origin: Origin | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class KeySpec:
    """An asymmetric key to mint, or one in a PKCS #11 token.

    Attributes:
        algorithm: ``"ec"`` or ``"rsa"``.
        curve: for EC, upper case SEC name, e.g. ``SECP256R1``; else empty.
        size: for RSA, bits; else 0.
        password_env: name of the environment variable that holds the password the stored key is encrypted with;
            empty for an unencrypted key (mode 0600).
        uri: URI of the private key in its token (RFC 7512); empty for a key in a file.
        pin_env: name of the environment variable that holds the PIN of the token; empty for the usual one.
    """

    algorithm: str
    curve: str = ""
    size: int = 0
    password_env: str = ""
    uri: str = ""
    pin_env: str = ""


@dataclass(frozen=True, slots=True)
class Extension:
    """An X.509 v3 extension in the notation of OpenSSL's ``x509v3_config``.

    Attributes:
        name: short name (``basicConstraints``, ``keyUsage``, ``extendedKeyUsage``, ``subjectAltName``, …).
        value: e.g. ``CA:TRUE, pathlen:0`` or ``digitalSignature, keyCertSign``.
        critical: marks the extension critical.
        origin: where it is written.
    """

    name: str
    value: str
    critical: bool
    origin: Origin


@dataclass(frozen=True, slots=True)
class CertificateSpec:
    """A certificate to issue.

    Attributes:
        subject_name: distinguished name as text (RFC 4514 or OpenSSL's one-line form), placeholders expanded, in
            certificate order: ``CN=/talker,OU=2f…``.
        validity: the requested period; it is clamped to the issuer's when the certificate is issued.
        serial: serial number, or None for a random one.
        issuer: name of the issuing authority; empty for a self-signed certificate.
        hash_algorithm: ``SHA256``, ``SHA384`` or ``SHA512``.
        key: the key pair.
        extensions: extensions that add to or replace the defaults of its role (authority or identity).
        origin: where it is requested.
        adopted: PEM of the certificate itself, if somebody else issued it: it is used as it is. Else empty.
    """

    subject_name: str
    validity: Validity
    serial: int | None
    issuer: str
    hash_algorithm: str
    key: KeySpec
    extensions: tuple[Extension, ...]
    origin: Origin
    adopted: bytes = b""


class Phase(StrEnum):
    """How far the replacement of an authority's key has come."""

    DISTRIBUTE = "distribute"
    """All enclaves trust the next authority beside the present one, which still issues."""
    REISSUE = "reissue"
    """The next authority issues, and all enclaves still trust the former one beside it."""
    STAGE = "stage"
    """A second keystore, by the next authority, lies beside the one in force."""
    END = "end"
    """There is one authority again, the next one; nothing records this phase."""


@dataclass(frozen=True, slots=True)
class Rollover:
    """The replacement of an authority's key, under way.

    Attributes:
        phase: how far it has come.
        certificate: PEM of the authority's other certificate: the next one, in :attr:`Phase.REISSUE` the former one.
    """

    phase: Phase
    certificate: bytes


@dataclass(frozen=True, slots=True)
class AuthorityIssuance:
    """What was decided about the certificate of an authority, beyond the documents of its owner.

    Attributes:
        renewed: when it was renewed, UTC: it ends as long after that as these documents say for its begin, which stays.
            None if it was never renewed.
        adopted: PEM of a certificate that somebody else issued, or that was issued after such a one; else empty.
        rollover: the replacement of its key, or None if none is under way.
        exposed: as :attr:`Issuance.exposed`.
    """

    renewed: datetime | None = None
    adopted: bytes = b""
    rollover: Rollover | None = None
    exposed: str = ""


@dataclass(frozen=True, slots=True)
class Authority:
    """A certificate authority of the workspace.

    Attributes:
        name: its name in the profile.
        certificate: its certificate, with the validity that it has since it was renewed.
        issuance: what was decided about it beyond the documents of its owner.
    """

    name: str
    certificate: CertificateSpec
    issuance: AuthorityIssuance = AuthorityIssuance()
