# SPDX-License-Identifier: Apache-2.0
"""What profile and package documents say of certificates, keys and grants, completed by their defaults.

Distinguished names may have placeholders, such as ``{name}``; braces have no other use there.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping

from lxml import etree

from comarmor.text import did_you_mean, lazy_regex
from comarmor.values import Data, replace
from comarmor.xml.reader import line
from keymint.api import CertificateSpec, DomainRange, Extension, KeySpec, Validity
from keymint.api.source_documents import domains, incomplete, place, require_new, text
from keymint.errors import KeymintError, Origin
from keymint_ros import validity

AUTHORITY_PLACEHOLDERS = ("name",)
"""Placeholders of an authority: its name in the profile."""
SUBJECT_PLACEHOLDERS = ("name", "subject", "common_name", "unique")
"""Placeholders of a package: its name, ``/`` + name, common name and unique suffix."""

_BRACES = lazy_regex(r"\{([^{}]*)\}|[{}]")


def name_with_placeholders(element: etree._Element | None, known: Collection[str]) -> str | None:
    """Return the text of a ``<subject_name>``, or None if there is no element.

    Raises:
        KeymintError: a placeholder is not in ``known``, or a brace has no partner.
    """
    if element is None:
        return None
    name = text(element) or ""
    # With a blank for each known placeholder, a name has no braces left.
    rest = functools.reduce(lambda rest, each: rest.replace(f"{{{each}}}", " "), known, name)
    for match in () if {"{", "}"}.isdisjoint(rest) else _BRACES.finditer(name):
        if match.group(1) not in known:
            choices = ", ".join(f"{{{placeholder}}}" for placeholder in known)
            message = f"unknown placeholder {match.group()!r} in {name!r}"
            help_ = did_you_mean(match.group(1) or "", known, f"the placeholders are {choices}")
            raise KeymintError(message, where=place(element), help=help_, code="placeholder-unknown")
    return name


def expanded_name(name: str, values: Mapping[str, str]) -> str:
    """Replace each placeholder of a name that :func:`name_with_placeholders` returned by its value.

    In the name of the root enclave ``/``, the common name comes first if a placeholder gives it: a grant has the RDNs
    the other way round, and Cyclone DDS finds none for a name in which a ``,`` follows the ``/``.
    """
    # Not by format(), whose placeholders may name attributes and widths.
    before, *others = name.split("{")
    parts = (each.partition("}") for each in others)
    expanded = before + "".join(f"{values[placeholder]}{after}" for placeholder, _, after in parts)
    if values.get("common_name") != "/" or expanded == name:
        return expanded
    from keymint.pki import distinguished_names  # noqa: PLC0415 - as in placeholder_values

    try:
        return distinguished_names.common_name_first(expanded)
    except KeymintError:
        return expanded  # reported where the certificate is made


def placeholder_values(subject: str, generation: int = 0, *, in_common_name: bool = False) -> Mapping[str, str]:
    """Return the values of :data:`SUBJECT_PLACEHOLDERS` for a generation of a subject.

    Args:
        subject: the subject's name, e.g. ``/robot1/talker``.
        generation: generation of its identity; the unique suffix has it.
        in_common_name: its names have it as well, for a transport that knows a subject by its common name alone.
    """
    from keymint.pki import distinguished_names  # noqa: PLC0415 - imports cryptography, which takes 0.1 s

    named = generation if in_common_name else 0
    mark = distinguished_names.generation_mark(named)
    return {
        "name": subject.removeprefix("/") + mark,
        "subject": subject + mark,
        "common_name": distinguished_names.common_name(subject, named),
        "unique": distinguished_names.unique_suffix(subject, generation),
    }


_RANDOM = 0
_TRUE = frozenset({"true", "1"})
_BASIC_CONSTRAINTS = "BasicConstraints"
_SERIAL_OCTETS = 20
_CURVES = {"prime256v1": "SECP256R1"}
"""SEC's names of curves, by OpenSSL's."""
_DEFAULT_KEY = KeySpec(algorithm="ec", curve="SECP256R1")
"""Used where neither a document nor its defaults describe a key. Every DDS vendor accepts it."""
_DEFAULT_HASH = "SHA256"


class IssuedElement(Data):
    """An ``<identity>``, ``<authority>``, ``<grant>`` or ``<defaults>`` element; None for each part that it leaves out.

    Attributes:
        line: line of the element.
        file: its document, for messages; empty until :meth:`in_file` sets it, as in the places of its parts.
        domains: those of a grant; empty if it leaves them out.
        serial: 0 for a random one, which an empty element or a number that is not positive requests.
        issuer: name of the issuing authority; empty if self-signed.
        issuer_line: line of the issuer's element.
    """

    line: int
    file: str = ""
    domains: tuple[DomainRange, ...] = ()
    subject_name: str | None = None
    validity: Validity | None = None
    serial: int | None = None
    issuer: str | None = None
    issuer_line: int = 0
    hash_algorithm: str | None = None
    extensions: tuple[Extension, ...] | None = None
    key: KeySpec | None = None

    @property
    def origin(self) -> Origin:
        """The place of the element."""
        return Origin(self.file, self.line)

    def in_file(self, file: str) -> IssuedElement:
        """Return the element of a document, which is read without a look at its path.

        Args:
            file: the path as the user would type it.
        """
        period, extensions = self.validity, self.extensions
        return replace(
            self,
            file=file,
            validity=period and replace(period, origin=_in_file(period.origin, file)),
            extensions=extensions and tuple(replace(each, origin=_in_file(each.origin, file)) for each in extensions),
        )


def _in_file(where: Origin | None, file: str) -> Origin:
    return Origin(file, where.line if where else 0)


def read(element: etree._Element, known: Collection[str]) -> IssuedElement:
    """Read an ``<identity>``, ``<authority>``, ``<grant>`` or ``<defaults>`` element.

    Args:
        element: contains ``<cert>`` and ``<key>``, or directly the parts of both, or those of a grant.
        known: the placeholders allowed in its subject name.

    Raises:
        KeymintError: with the line of the first defect.
    """
    cert = element if element.tag in {"defaults", "grant"} else element.find("cert")
    parts = {} if cert is None else {part.tag: part for part in cert}
    serial, issuer_name = parts.get("serial_number"), parts.get("issuer_name")
    extensions, key = parts.get("extensions"), element.find("key")
    return IssuedElement(
        line=line(element),
        domains=domains(parts.get("domains")),
        subject_name=name_with_placeholders(parts.get("subject_name"), known),
        validity=validity.read(parts.get("validity")),
        serial=None if serial is None else _serial(serial),
        issuer=text(issuer_name),
        issuer_line=0 if issuer_name is None else line(issuer_name),
        hash_algorithm=text(parts.get("hash_algorithm")),
        extensions=None if extensions is None else _extensions(extensions),
        key=None if key is None else _key(key),
    )


def complete(own: IssuedElement, defaults: IssuedElement, values: Mapping[str, str]) -> tuple[CertificateSpec, Origin]:
    """Return the certificate that an element and its defaults describe together, and the place that names its issuer.

    Args:
        own: the element; the defaults themselves if there is none.
        defaults: values for everything that the element leaves out.
        values: values of the placeholders; if empty, they are left as they are.

    Raises:
        KeymintError: neither of them has a subject name or a validity.
    """
    subject_name = own.subject_name or defaults.subject_name
    period = own.validity or defaults.validity
    if subject_name is None or period is None:
        raise incomplete("certificate", "subject_name" if subject_name is None else "validity", defaults.origin)
    names_issuer = defaults if own.issuer is None and defaults.issuer is not None else own
    says_nothing = own == IssuedElement(own.line, own.file)
    spec = CertificateSpec(
        subject_name=expanded_name(subject_name, values) if values else subject_name,
        validity=period,
        serial=(defaults.serial if own.serial is None else own.serial) or None,
        issuer=names_issuer.issuer or "",
        hash_algorithm=own.hash_algorithm or defaults.hash_algorithm or _DEFAULT_HASH,
        key=_complete_key(own.key or defaults.key or _DEFAULT_KEY, defaults.key),
        extensions=(defaults.extensions if own.extensions is None else own.extensions) or (),
        origin=defaults.origin if says_nothing else own.origin,
    )
    return spec, Origin(names_issuer.file, names_issuer.issuer_line or names_issuer.line)


def pem(element: etree._Element | None) -> bytes:
    """Return the certificate of an element in the one form of PEM that Keymint writes; empty if there is no element.

    Raises:
        KeymintError: not one certificate, or one whose key is neither EC nor RSA.
    """
    if element is None:
        return b""
    from keymint.pki import certificates  # noqa: PLC0415 - few documents have one, and it takes time to import

    loaded = certificates.load((text(element) or "").encode(), place(element))
    certificates.public_key(loaded, place(element))
    return certificates.to_pem(loaded)


def _serial(element: etree._Element) -> int:
    """Return a serial number (RFC 5280, 4.1.2.2: positive, at most 20 octets).

    One that is not positive means a random one: documents of 2018 have 0 or -1 for it.
    """
    number = text(element)
    if not number:
        return _RANDOM
    serial = max(_RANDOM, int(number))
    if serial >= 1 << 8 * _SERIAL_OCTETS - 1:
        message = f"the serial number {number} is not a positive number of at most {_SERIAL_OCTETS} octets"
        help_ = "leave the element empty for a random one"
        raise KeymintError(message, where=place(element), help=help_, code="serial-invalid")
    return serial


def _extensions(element: etree._Element) -> tuple[Extension, ...]:
    extensions: dict[str, Extension] = {}
    for item in element:
        of_2018 = item.tag == _BASIC_CONSTRAINTS
        name = "basicConstraints" if of_2018 else item.get("name", "").strip()
        message = f"the extension {name} is given twice"
        help_ = "write its values into one element, separated by commas"
        require_new(name, extensions, item, message, help_, "extension-doubled")
        value = _basic_constraints(item) if of_2018 else text(item) or ""
        extensions[name] = Extension(name, value, item.get("critical", "false").strip() in _TRUE, place(item))
    return tuple(extensions.values())


def _basic_constraints(element: etree._Element) -> str:
    """Return the value of ``<BasicConstraints>``, an extension as documents of 2018 write it."""
    path_length, is_authority = element.find("path_length"), text(element.find("ca")) in _TRUE
    if path_length is None:
        return "CA:TRUE" if is_authority else "CA:FALSE"
    if not is_authority:
        message = "<path_length> is given for a certificate that is not an authority's (RFC 5280, 4.2.1.9)"
        help_ = "remove it, or write <ca>true</ca> for an authority"
        raise KeymintError(message, where=place(path_length), help=help_, code="extension-invalid")
    return f"CA:TRUE, pathlen:{int(text(path_length) or 0)}"


def _complete_key(key: KeySpec, defaults: KeySpec | None) -> KeySpec:
    """Return a key with its type, which that of a key in a token may leave out."""
    if key.algorithm:
        return key
    typed = defaults if defaults is not None and defaults.algorithm else _DEFAULT_KEY
    return replace(key, algorithm=typed.algorithm, curve=typed.curve, size=typed.size)


def _key(element: etree._Element) -> KeySpec:
    uri, key = element.find("pkcs11"), KeySpec("")
    for algorithm in element.iterfind("asymmetric_type/*"):
        parameter = text(algorithm[0]) or ""
        is_ec = algorithm.tag == "ec"
        key = KeySpec("ec", curve=_CURVES.get(parameter, parameter)) if is_ec else KeySpec("rsa", size=int(parameter))
    if uri is not None:
        return _token_key(element, key, uri)
    pin_env = element.find("pin_env")
    if not key.algorithm or pin_env is not None:
        message = "<pin_env> is given, but no token" if key.algorithm else "a key without <asymmetric_type>"
        help_ = "write <pkcs11>pkcs11:token=…;object=…</pkcs11> if it lies in a token, else its type"
        where = place(element if pin_env is None else pin_env)
        raise KeymintError(message, where=where, help=help_, code="key-incomplete")
    encryption, password_env = element.find("encryption_algorithm"), text(element.find("password_env")) or ""
    encrypted = text(encryption) == "BestAvailableEncryption"
    if encrypted != bool(password_env):
        message = "<password_env> is given, but the key is not encrypted"
        help_ = "write <encryption_algorithm>BestAvailableEncryption</encryption_algorithm>, or empty <password_env>"
        if encrypted:
            message = "an encrypted key needs a <password_env>"
            help_ = "name the environment variable that will contain the password, e.g. CA_PASSWORD"
        where = place(element if encryption is None else encryption)
        raise KeymintError(message, where=where, help=help_, code="key-password")
    return replace(key, password_env=password_env)


def _token_key(element: etree._Element, key: KeySpec, uri: etree._Element) -> KeySpec:
    """Return a key in a token; its URI is checked here, so that a typing error has its line."""
    for name in ("encryption_algorithm", "password_env"):
        given = element.find(name)
        if given is not None and text(given) not in {"", "NoEncryption", None}:
            message = f"<{name}> is given for a key in a token, which no file contains"
            help_ = "leave it out; <pin_env> names the environment variable of the PIN"
            raise KeymintError(message, where=place(given), help=help_, code="key-password")
    from keymint.pki.tokens import pkcs11_uri  # noqa: PLC0415 - few documents need it

    given_uri = text(uri) or ""
    pkcs11_uri.parse(given_uri, place(uri))
    return replace(key, uri=given_uri, pin_env=text(element.find("pin_env")) or "")
