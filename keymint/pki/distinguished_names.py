# SPDX-License-Identifier: Apache-2.0
"""Distinguished names: parsed from text, and written as text.

Names are written in *certificate order*, first RDN first: ``C=US, O=Acme, CN=ca``. RFC 4514 prints a name the
other way round.
"""

from __future__ import annotations

import hashlib
import string
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache

from cryptography import x509
from cryptography.x509.oid import NameOID

from comarmor.text import did_you_mean, lazy_regex, quote
from comarmor.values import Data
from keymint.errors import KeymintError, Origin
from keymint.pki import der

MAX_COMMON_NAME = 64
"""ub-common-name of RFC 5280, appendix A.1."""
MAX_SEGMENTS = 16
"""Maximum path segments of a common name: some software compares at most 20 parts of a name, RDNs included."""

# Short name -> OID, upper bound of RFC 5280, appendix A.1. The short names are OpenSSL's.
_TYPES: dict[str, tuple[x509.ObjectIdentifier, int]] = {
    "CN": (NameOID.COMMON_NAME, MAX_COMMON_NAME),
    "C": (NameOID.COUNTRY_NAME, 2),
    "ST": (NameOID.STATE_OR_PROVINCE_NAME, 128),
    "L": (NameOID.LOCALITY_NAME, 128),
    "O": (NameOID.ORGANIZATION_NAME, 64),
    "OU": (NameOID.ORGANIZATIONAL_UNIT_NAME, 64),
    "DC": (NameOID.DOMAIN_COMPONENT, 63),
    "UID": (NameOID.USER_ID, 256),
    "emailAddress": (NameOID.EMAIL_ADDRESS, 255),
    "serialNumber": (NameOID.SERIAL_NUMBER, 64),
    "SN": (NameOID.SURNAME, 64),
    "GN": (NameOID.GIVEN_NAME, 64),
    "title": (NameOID.TITLE, 64),
    "street": (NameOID.STREET_ADDRESS, 128),
    "postalCode": (NameOID.POSTAL_CODE, 40),
    "dnQualifier": (NameOID.DN_QUALIFIER, 64),
    "pseudonym": (NameOID.PSEUDONYM, 128),
}
_ALIASES = {
    "commonName": "CN",
    "countryName": "C",
    "stateOrProvinceName": "ST",
    "S": "ST",
    "localityName": "L",
    "organizationName": "O",
    "organizationalUnitName": "OU",
    "domainComponent": "DC",
    "userId": "UID",
    "E": "emailAddress",
    "email": "emailAddress",
    "surname": "SN",
    "givenName": "GN",
    "streetAddress": "street",
}
_CANONICAL = {name.lower(): name for name in _TYPES} | {alias.lower(): name for alias, name in _ALIASES.items()}
_SHORT = {oid: name for name, (oid, _) in _TYPES.items()}
_ASCII_TYPES = frozenset({"C", "DC", "emailAddress", "serialNumber", "dnQualifier"})
"""Types whose ASN.1 string is PrintableString or IA5String."""
_UNBOUNDED = 1024
"""Maximum characters of a value whose type has no upper bound of its own."""

_TYPE_THEN_EQUALS = lazy_regex(r"\s*([A-Za-z][A-Za-z0-9.-]*|[0-9][0-9.]*)\s*= *")
_PART = lazy_regex(r"""\\(?P<escaped>[0-9A-Fa-f]{2}|[,+"\\<>;=/# ])|[\\,/"+]|[^\\,/"+]+""")
"""What a value consists of: an escaped byte or character, a character that may end it, or other text."""
_HEX_PAIR = 3
"""Characters of an escaped byte."""
_ESCAPABLE = frozenset(',+"\\<>;=/# ')
_ESCAPED_IN_TEXT = frozenset(',+"\\<>;')
_PLAIN = frozenset(f"{string.ascii_letters}{string.digits}/_.-")
"""Characters of values in which nothing is escaped: without ``=``, no ``/`` begins an attribute."""
_USUAL_TYPES = {"CN": der.oid("2.5.4.3"), "OU": der.oid("2.5.4.11")}
"""A simple name with these only, which are short, is known in all forms without the library."""
_EXAMPLE = "write e.g. CN=/robot/camera,OU=x1 or /C=US/O=Acme/CN=ca"


def parse(text: str, where: Origin | None = None) -> x509.Name:
    r"""Parse a name in certificate order.

    Accepts the comma form (RFC 4514, but in certificate order; ``\`` escapes, spaces around a comma are skipped),
    OpenSSL's one-line form ``/C=US/CN=ca``, and mixtures: ``O=Acme, CN=ca/emailAddress=a@b.c``.
    A ``/`` begins an RDN if a known attribute type and ``=`` follow; ``CN=/robot/arm`` is one value.

    Args:
        text: the name.
        where: its origin, for messages.

    Raises:
        KeymintError: the text is not a name; with what is allowed.
    """
    try:
        return _parsed(text)
    except KeymintError as error:
        raise error.at(where) from None


@lru_cache(maxsize=1024)
def _parsed(text: str) -> x509.Name:
    if not text.strip():
        raise KeymintError("a subject name is empty", help=_EXAMPLE, code="name-invalid")
    return x509.Name([_attribute(kind, value, text) for kind, value in _pairs(text)])


class WrittenName(Data):
    """A name in the forms in which it is written.

    Attributes:
        encoded: in DER.
        text: as :func:`to_text` writes it.
        values: those of its values in which nothing is escaped, in certificate order.
    """

    encoded: bytes
    text: str
    values: tuple[str, ...]


@lru_cache(maxsize=1024)
def written_name(text: str) -> WrittenName:
    """Return a name in the forms in which it is written; errors as :func:`parse`, without a place."""
    parts = [part.partition("=") for part in text.split(",")]
    if not all(kind in _USUAL_TYPES and _is_plain(value) and len(value) <= MAX_COMMON_NAME for kind, _, value in parts):
        name = _parsed(text)
        plain = tuple(value for _, value in attributes(name) if _is_plain(value))
        return WrittenName(name.public_bytes(), to_text(name), plain)
    values, encoded = list[str](), list[bytes]()
    for kind, _, value in parts:
        # Each part of a SET of a SEQUENCE of type and UTF8String is so short that its length takes one byte.
        type_, size = _USUAL_TYPES[kind], len(value)
        around, own = len(type_) + size + 2, (der.UTF8_STRING, size)
        encoded.append(bytes((der.SET, around + 2, der.SEQUENCE, around)) + type_ + bytes(own) + value.encode())
        values.append(value)
    return WrittenName(der.tlv(der.SEQUENCE, *encoded), text, tuple(values))


def attributes(name: x509.Name) -> Iterator[tuple[str, str]]:
    """Yield the attributes of a name in certificate order: the type's short name or dotted OID, and the value."""
    yield from ((_SHORT.get(part.oid, part.oid.dotted_string), _string(part)) for part in name)


def to_text(name: x509.Name) -> str:
    r"""Return a name as text in certificate order, ``O=Acme\, Inc,CN=ca``; :func:`parse` reads it back."""
    return ",".join(f"{kind}={_escape(value)}" for kind, value in attributes(name))


def has_same_rdns(name: x509.Name, other: x509.Name) -> bool:
    """Tell whether two names have the same RDNs, in any order."""
    return Counter(name.rdns) == Counter(other.rdns)


def common_name_first(text: str) -> str:
    """Return a name whose common name comes first, in certificate order; else the order stays.

    Args:
        text: a name as :func:`parse` reads it.

    Raises:
        KeymintError: the text is not a name.
    """
    return to_text(x509.Name(sorted(parse(text), key=lambda part: part.oid != NameOID.COMMON_NAME)))


def common_name(subject: str, generation: int = 0) -> str:
    """Return the common name of a subject: its name, or its last segments if that exceeds a limit.

    A shortened common name is not unique: combine it with an RDN of :func:`unique_suffix`. A generation above 0 follows
    a ``.``, which no ROS name has: ``/robot1/arm/driver.2``.

    Args:
        subject: a subject's name, e.g. ``/robot1/arm/driver``.
        generation: generation of the identity, from 0.
    """
    mark = generation_mark(generation)
    most = MAX_COMMON_NAME - len(mark)
    segments = subject.removeprefix("/").split("/")
    for first in range(max(0, len(segments) - MAX_SEGMENTS), len(segments)):
        candidate = "/" + "/".join(segments[first:])
        if len(candidate) <= most:
            return candidate + mark
    return f"/{segments[-1]}"[:most] + mark


def generation_mark(generation: int) -> str:
    """Return what follows a name in a common name of this generation; empty for generation 0."""
    return f".{generation}" if generation else ""


def unique_suffix(subject: str, generation: int = 0) -> str:
    """Return 32 hexadecimal digits that are unique to a generation of a subject: half of a SHA-256.

    It is that of the name, for a generation above 0 of the name, a line feed and the generation in decimal digits.
    """
    named = f"{subject}\n{generation}" if generation else subject
    return hashlib.sha256(named.encode()).hexdigest()[:32]


def _invalid(text: str, problem: str, help_: str = "") -> KeymintError:
    return KeymintError(f"{quote(text, 120)} is not a subject name: {problem}", help=help_, code="name-invalid")


def _pairs(text: str) -> Iterator[tuple[str, str]]:
    """Yield attribute types, as written, and values, unescaped."""
    parts = [part.partition("=") for part in text.split(",")]
    if all(kind.isascii() and kind.isalpha() and _is_plain(value) for kind, _, value in parts):
        yield from ((kind, value) for kind, _, value in parts)
        return
    position = 1 if text.startswith("/") and _TYPE_THEN_EQUALS.match(text, 1) else 0
    while True:
        match = _TYPE_THEN_EQUALS.match(text, position)
        if match is None:
            rest = text[position:].strip()
            problem = f"no attribute type and '=' in {quote(rest, 60)}" if rest else "it ends with a separator"
            raise _invalid(text, problem, rf"{_EXAMPLE}; a comma inside a value is written \,")
        value, position = _value(text, match.end())
        yield match.group(1), value
        if position >= len(text):
            return
        position += 1


def _value(text: str, position: int) -> tuple[str, int]:
    """Return the value that begins at a position, unescaped, and the position of the separator after it."""
    raw = bytearray()
    kept = 0  # bytes to keep when spaces are trimmed, because they were escaped
    while part := _PART.match(text, position):
        shown = part[0]
        if part["escaped"] is not None:
            raw += bytes.fromhex(part["escaped"]) if len(shown) == _HEX_PAIR else part["escaped"].encode()
            kept = len(raw)
        elif shown == "\\":
            expected = f"one of {''.join(sorted(_ESCAPABLE))!r} or two hexadecimal digits"
            raise _invalid(text, f"expected after '\\' {expected}", "write \\\\ for a backslash")
        elif shown == "," or (shown == "/" and _begins_attribute(text, part.end())):
            break
        elif shown == '"' or (shown == "+" and _begins_attribute(text, part.end())):
            problem = "values are not quoted" if shown == '"' else "RDNs with several attributes are not supported"
            help_ = f"separate attributes by ',', or write \\{shown} for the character itself"
            raise _invalid(text, problem, help_)
        else:
            raw += shown.encode("utf-8", "surrogatepass")
        position = part.end()
    try:
        return (raw[:kept] + raw[kept:].rstrip(b" ")).decode(), position
    except UnicodeDecodeError:
        raise _invalid(text, "an escaped value is not UTF-8") from None


def _begins_attribute(text: str, position: int) -> bool:
    match = _TYPE_THEN_EQUALS.match(text, position)
    return match is not None and match.group(1).lower() in _CANONICAL


def _attribute(kind: str, value: str, name: str) -> x509.NameAttribute[str]:
    """Return the attribute of a type and a value, both checked."""
    oid, most = _type(kind)
    short = _SHORT.get(oid, kind)
    size = len(value.encode())
    problems = (
        (not value, "is empty"),
        (not value.isprintable(), "has a control character"),
        (size > most, f"has {size} bytes, the maximum is {most} (RFC 5280)"),
        (short == "C" and size != most, "must be a country code of two letters"),
        (short in _ASCII_TYPES and not value.isascii(), "must be ASCII"),
    )
    if problem := next((text for applies, text in problems if applies), ""):
        too_long = short == "CN" and size > most
        help_ = "OU={unique},CN={common_name} shortens it and keeps it unique" if too_long else _EXAMPLE
        raise _invalid(name, f"{short} {problem}", help_)
    return x509.NameAttribute(oid, value)


def _type(kind: str) -> tuple[x509.ObjectIdentifier, int]:
    """Return the OID and the upper bound of an attribute type: a known name, or a dotted OID."""
    if short := _CANONICAL.get(kind.lower()):
        return _TYPES[short]
    if kind[0].isdigit():
        with suppress(ValueError):
            oid = x509.ObjectIdentifier(kind)
            return _TYPES[_SHORT[oid]] if oid in _SHORT else (oid, _UNBOUNDED)
    known = [*_TYPES, *_ALIASES]
    help_ = did_you_mean(kind, known, f"known are {', '.join(known)} and dotted OIDs")
    raise KeymintError(f"{kind!r} is not an attribute type of a subject name", help=help_, code="name-invalid")


def _is_plain(value: str) -> bool:
    return value != "" and _PLAIN.issuperset(value)


def _string(part: x509.NameAttribute[str | bytes]) -> str:
    return part.value if isinstance(part.value, str) else part.value.hex()


def _escape(value: str) -> str:
    """Return a value as :func:`parse` reads it: escaped by RFC 4514, 2.4, and a ``/`` that would separate."""
    if _is_plain(value):
        return value
    escaped = [
        f"\\{character}"
        if character in _ESCAPED_IN_TEXT or (character == "/" and _begins_attribute(value, position + 1))
        else character
        for position, character in enumerate(value)
    ]
    if value[0] in " #":
        escaped[0] = f"\\{value[0]}"
    if value[-1] == " ":
        escaped[-1] = "\\ "
    return "".join(escaped)
