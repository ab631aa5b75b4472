"""What documents say of certificates and keys, and how a document is completed by its defaults."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from comarmor.errors import Origin
from keymint.api import CertificateSpec, Extension, KeySpec, Validity
from keymint.errors import KeymintError
from keymint_ros import placeholders, validity
from keymint_ros.document import line, place, text

if TYPE_CHECKING:
    from lxml import etree

_RANDOM = 0
_SERIAL_OCTETS = 20
_CURVES = {"prime256v1": "SECP256R1"}
"""OpenSSL's names of curves, and SEC's."""
_KEY = KeySpec(algorithm="ec", curve="SECP256R1")
"""The key where neither a document nor its defaults ask for one: what every DDS vendor takes."""
_HASH = "SHA256"


@dataclass(frozen=True, slots=True)
class Issuer:
    """The name of an issuing authority (empty: self-signed), and the line where it is given."""

    name: str
    line: int


@dataclass(frozen=True, slots=True)
class Written:
    """What one document says of a certificate; None for what it leaves out.

    Attributes:
        line: line of the element that asks for the certificate.
        serial: 0 for a random one, asked for by an empty element.
    """

    line: int
    subject_name: str | None = None
    validity: Validity | None = None
    serial: int | None = None
    issuer: Issuer | None = None
    hash_algorithm: str | None = None
    extensions: tuple[Extension, ...] | None = None
    key: KeySpec | None = None

    @property
    def says_something(self) -> bool:
        """Whether the document sets anything, so that not all comes from the defaults."""
        return self != Written(self.line)


@dataclass(frozen=True, slots=True)
class Source:
    """What a document says of a certificate, and the path of that document for messages."""

    file: str
    written: Written

    @property
    def origin(self) -> Origin:
        """Where the certificate is asked for."""
        return Origin(self.file, self.written.line)


def read(element: etree._Element, known: Collection[str]) -> Written:
    """Return what an ``<identity>``, ``<authority>`` or ``<defaults>`` element says of a certificate.

    Args:
        element: with ``<cert>`` and ``<key>``, or with the parts of both directly in it.
        known: the placeholders that its subject name may have.

    Raises:
        KeymintError: with the line of the first defect.
    """
    cert = element if element.tag == "defaults" else element.find("cert")
    parts = {} if cert is None else {part.tag: part for part in cert}
    subject, serial, issuer = parts.get("subject_name"), parts.get("serial_number"), parts.get("issuer_name")
    period, extensions, key = parts.get("validity"), parts.get("extensions"), element.find("key")
    return Written(
        line=line(element),
        subject_name=None if subject is None else placeholders.check(text(subject) or "", known, place(subject)),
        validity=None if period is None else validity.read(period),
        serial=None if serial is None else _serial(serial),
        issuer=None if issuer is None else Issuer(text(issuer) or "", line(issuer)),
        hash_algorithm=text(parts.get("hash_algorithm")),
        extensions=None if extensions is None else _extensions(extensions),
        key=None if key is None else _key(key),
    )


def complete(own: Source | None, defaults: Source, values: Mapping[str, str]) -> CertificateSpec:
    """Return the certificate that a document and its defaults ask for together.

    Args:
        own: the document; None when there is none.
        defaults: says what the document leaves out.
        values: of the placeholders.

    Raises:
        KeymintError: neither gives a subject name or a validity.
    """
    first = own or defaults
    said, other = first.written, defaults.written
    subject_name = said.subject_name or other.subject_name
    period = validity.written(said.validity, first.file, other.validity, defaults.file)
    if subject_name is None or period is None:
        missing = "subject_name" if subject_name is None else "validity"
        raise KeymintError(
            f"the certificate has no <{missing}>, neither in its own document nor in these defaults",
            where=defaults.origin,
            help=f"add a <{missing}> to it",
            code="certificate-incomplete",
        )
    extensions, file = (
        (said.extensions, first.file) if said.extensions is not None else (other.extensions, defaults.file)
    )
    serial = said.serial if said.serial is not None else other.serial
    return CertificateSpec(
        subject_name=placeholders.expand(subject_name, values),
        validity=period,
        serial=serial or None,
        issuer=issuer(own, defaults)[0],
        hash_algorithm=said.hash_algorithm or other.hash_algorithm or _HASH,
        key=said.key or other.key or _KEY,
        extensions=tuple(replace(one, origin=Origin(file, one.origin.line)) for one in extensions or ()),
        origin=first.origin if first.written.says_something else defaults.origin,
    )


def issuer(own: Source | None, defaults: Source) -> tuple[str, Origin]:
    """Return the name of the issuing authority, empty when none is given, and where it is given."""
    for said in (own, defaults):
        if said is not None and said.written.issuer is not None:
            return said.written.issuer.name, Origin(said.file, said.written.issuer.line)
    return "", (own or defaults).origin


def _serial(element: etree._Element) -> int:
    """Return a serial number (RFC 5280, 4.1.2.2: positive, at most 20 octets)."""
    said = text(element)
    if not said:
        return _RANDOM
    serial = int(said)
    if not 0 < serial < 1 << 8 * _SERIAL_OCTETS - 1:
        raise KeymintError(
            f"the serial number {said} is not a positive number of at most {_SERIAL_OCTETS} octets",
            where=place(element),
            help="leave the element empty for a random one",
            code="serial-invalid",
        )
    return serial


def _extensions(element: etree._Element) -> tuple[Extension, ...]:
    found: dict[str, Extension] = {}
    for one in element:
        name = one.get("name", "").strip()
        if name in found:
            raise KeymintError(
                f"the extension {name} is given twice",
                where=place(one),
                help="write its values into one element, separated by commas",
                code="extension-doubled",
            )
        critical = one.get("critical", "false").strip() in {"true", "1"}
        found[name] = Extension(name, text(one) or "", critical, place(one))
    return tuple(found.values())


def _key(element: etree._Element) -> KeySpec:
    (asymmetric,) = element.iterfind("asymmetric_type/*")
    said = text(asymmetric[0]) or ""
    encryption, password_env = element.find("encryption_algorithm"), text(element.find("password_env")) or ""
    encrypted = text(encryption) == "BestAvailableEncryption"
    if encrypted != bool(password_env):
        raise KeymintError(
            "the key is to be encrypted, but no <password_env> names its password"
            if encrypted
            else "a <password_env> is given, but the key is not to be encrypted",
            where=place(element if encryption is None else encryption),
            help="name the environment variable that will hold the password, e.g. CA_PASSWORD"
            if encrypted
            else "write <encryption_algorithm>BestAvailableEncryption</encryption_algorithm>, or empty <password_env>",
            code="key-password",
        )
    if asymmetric.tag == "ec":
        return KeySpec("ec", curve=_CURVES.get(said, said), password_env=password_env)
    return KeySpec("rsa", size=int(said), password_env=password_env)
