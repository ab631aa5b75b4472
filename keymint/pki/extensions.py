# SPDX-License-Identifier: Apache-2.0
"""X.509 v3 extensions, parsed from OpenSSL's ``x509v3_config`` notation."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from cryptography import x509
from cryptography.x509.oid import AuthorityInformationAccessOID, ExtendedKeyUsageOID, ExtensionOID

from comarmor.text import did_you_mean, lazy_regex, quote
from comarmor.values import Data
from keymint.api import Extension
from keymint.errors import KeymintError
from keymint.pki import der
from keymint.pki.keys import PublicKey

_E = TypeVar("_E", bound=x509.ExtensionType)
_T = TypeVar("_T")
_Reader = Callable[[str, "Context"], x509.ExtensionType | None]
"""Returns the value of an extension for its text; None: omit the extension."""


class Context(Data):
    """The data that an extension may depend on: the subject's public key, and the issuer (None if self-signed)."""

    public_key: PublicKey
    issuer: x509.Certificate | None


_KEY_USAGES = {
    "digitalSignature": "digital_signature",
    "nonRepudiation": "content_commitment",
    "contentCommitment": "content_commitment",
    "keyEncipherment": "key_encipherment",
    "dataEncipherment": "data_encipherment",
    "keyAgreement": "key_agreement",
    "keyCertSign": "key_cert_sign",
    "cRLSign": "crl_sign",
    "encipherOnly": "encipher_only",
    "decipherOnly": "decipher_only",
}
"""Key usages (RFC 5280, 4.2.1.3) and their names in :class:`x509.KeyUsage`."""
_EXTENDED_KEY_USAGES = {
    "serverAuth": ExtendedKeyUsageOID.SERVER_AUTH,
    "clientAuth": ExtendedKeyUsageOID.CLIENT_AUTH,
    "codeSigning": ExtendedKeyUsageOID.CODE_SIGNING,
    "emailProtection": ExtendedKeyUsageOID.EMAIL_PROTECTION,
    "timeStamping": ExtendedKeyUsageOID.TIME_STAMPING,
    "OCSPSigning": ExtendedKeyUsageOID.OCSP_SIGNING,
    "ipsecIKE": ExtendedKeyUsageOID.IPSEC_IKE,
    "msSmartcardLogin": ExtendedKeyUsageOID.SMARTCARD_LOGON,
    "anyExtendedKeyUsage": ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE,
}
_ACCESS_METHODS = {"OCSP": AuthorityInformationAccessOID.OCSP, "caIssuers": AuthorityInformationAccessOID.CA_ISSUERS}
_NS_COMMENT = x509.ObjectIdentifier("2.16.840.1.113730.1.13")
_ANY_POLICY = x509.ObjectIdentifier("2.5.29.32.0")
_DOTTED = lazy_regex(r"[0-2](?:\.(?:0|[1-9][0-9]*))+")
_ASN1_STRINGS = {
    "UTF8": (der.UTF8_STRING, "utf-8"),
    "UTF8String": (der.UTF8_STRING, "utf-8"),
    "IA5": (der.IA5_STRING, "ascii"),
    "IA5STRING": (der.IA5_STRING, "ascii"),
    "PRINTABLE": (der.PRINTABLE_STRING, "ascii"),
    "PRINTABLESTRING": (der.PRINTABLE_STRING, "ascii"),
}


def key_usage(*names: str) -> x509.KeyUsage:
    """Return a key usage from OpenSSL's names.

    Raises:
        ValueError: a name is not a key of :data:`_KEY_USAGES`.
    """
    bits = dict.fromkeys(_KEY_USAGES.values(), False) | {_one_of(name, _KEY_USAGES): True for name in names}
    return x509.KeyUsage(**bits)


def usages(certificate: x509.Certificate) -> tuple[str, ...] | None:
    """Return OpenSSL's names of what the key of a certificate may be used for, each use once; None if for everything.

    The two qualifiers of keyAgreement are undefined without it (RFC 5280, 4.2.1.3).
    """
    usage = value(certificate, x509.KeyUsage)
    if usage is None:
        return None
    named = {attribute: name for name, attribute in _KEY_USAGES.items()}
    defined = [each for each in named if usage.key_agreement or each not in {"encipher_only", "decipher_only"}]
    return tuple(named[each] for each in defined if getattr(usage, each))


def may(certificate: x509.Certificate, *names: str) -> bool:
    """Tell whether the key of a certificate may be used for one of these, as :func:`usages` names them."""
    of_key = usages(certificate)
    return of_key is None or any(name in of_key for name in names)


def not_an_authority(certificate: x509.Certificate) -> str:
    """Return why a certificate may not issue others (RFC 5280, 4.2.1.3 and 4.2.1.9); empty if it may."""
    constraints = value(certificate, x509.BasicConstraints)
    if constraints is None or not constraints.ca:
        return "its basicConstraints lack CA:TRUE"
    return "" if may(certificate, "keyCertSign") else "its keyUsage lacks keyCertSign"


def authority_key_identifier(issuer: x509.Certificate) -> x509.AuthorityKeyIdentifier:
    """Return the identifier of the issuer's key, as the issuer's certificate has it (RFC 5280, 4.2.1.1)."""
    identifier = value(issuer, x509.SubjectKeyIdentifier)
    if identifier is None:
        return x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.public_key())  # type: ignore[arg-type]
    return x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier)


def value(of: x509.Certificate | x509.CertificateRevocationList | x509.RevokedCertificate, kind: type[_E]) -> _E | None:
    """Return the value of an extension of a certificate, a revocation list or an entry of one; None if it has none."""
    try:
        return of.extensions.get_extension_for_class(kind).value
    except x509.ExtensionNotFound:
        return None


def parse(extension: Extension, context: Context) -> tuple[x509.ObjectIdentifier, bool, x509.ExtensionType | None]:
    """Return the OID of an extension, whether it is critical, and its value (None: omit the extension).

    Accepts the names of :data:`_KNOWN`, and dotted OIDs with a value ``DER:hex`` or ``ASN1:type:text``.

    Args:
        extension: name, value and origin.
        context: resolves values such as ``hash`` and ``keyid``.

    Raises:
        KeymintError: an unknown name or a value that is not in the notation, with what was expected.
    """
    text = extension.value.strip()
    critical = extension.critical
    if marked := re.match(r"critical\s*,\s*", text):
        critical, text = True, text[marked.end() :]
    try:
        if known := _KNOWN.get(extension.name):
            oid, reader = known
            return oid, critical, reader(text, context)
        oid = _unknown(extension)
        return oid, critical, x509.UnrecognizedExtension(oid, _raw(text))
    except ValueError as error:
        raise KeymintError(
            f"{extension.name} = {quote(extension.value, 80)}: {error}",
            where=extension.origin,
            help="the notation is that of OpenSSL's x509v3_config(5)",
            code="extension-invalid",
        ) from None


def _unknown(extension: Extension) -> x509.ObjectIdentifier:
    """Return the OID of an extension named by a dotted OID.

    Raises:
        KeymintError: neither a known name nor a dotted OID, or the OID of a known name.
    """
    name = extension.name
    if _DOTTED.fullmatch(name):
        oid = x509.ObjectIdentifier(name)
        known = next((known for known, (other, _) in _KNOWN.items() if other == oid), None)
        if known is None:
            return oid
        problem, help_ = f"the extension {name} has a name", f"write {known}"
    else:
        problem = f"{name!r} is not a known extension"
        help_ = did_you_mean(name, _KNOWN, f"known are {', '.join(_KNOWN)} and dotted OIDs")
    raise KeymintError(problem, where=extension.origin, help=help_, code="extension-unknown")


def _items(text: str) -> list[str]:
    items = [item.strip() for item in text.split(",")]
    if not all(items):
        raise ValueError("an entry is empty")
    if len(set(items)) != len(items):
        raise ValueError("an entry occurs twice")
    return items


def _one_of(text: str, known: Mapping[str, _T]) -> _T:
    if text in known:
        return known[text]
    hint = did_you_mean(text, known, f"known are {', '.join(known)}")
    raise ValueError(f"{text!r} is not known, {hint}")


def _oid(text: str) -> x509.ObjectIdentifier:
    if not _DOTTED.fullmatch(text):
        raise ValueError(f"{text!r} is neither a known name nor a dotted OID")
    return x509.ObjectIdentifier(text)


def _basic_constraints(text: str, _: Context) -> x509.BasicConstraints:
    authority = None
    path_length = None
    for item in _items(text):
        name, _colon, rest = (part.strip() for part in item.partition(":"))
        if name == "CA" and rest.upper() in {"TRUE", "FALSE"}:
            authority = rest.upper() == "TRUE"
        elif name == "pathlen" and rest.isascii() and rest.isdigit():
            path_length = int(rest)
        else:
            raise ValueError(f"{item!r} is neither CA:TRUE, CA:FALSE nor pathlen:NUMBER")
    if authority is None:
        raise ValueError("CA:TRUE or CA:FALSE is missing")
    return x509.BasicConstraints(authority, path_length)


def _extended_key_usage(item: str) -> x509.ObjectIdentifier:
    return _oid(item) if item[0].isdigit() else _one_of(item, _EXTENDED_KEY_USAGES)


def _policy(item: str) -> x509.PolicyInformation:
    return x509.PolicyInformation(_ANY_POLICY if item == "anyPolicy" else _oid(item), None)


def _general_name(item: str) -> x509.GeneralName:
    kind, _, text = (part.strip() for part in item.partition(":"))
    makers: dict[str, Callable[[str], x509.GeneralName]] = {
        "DNS": x509.DNSName,
        "URI": x509.UniformResourceIdentifier,
        "email": x509.RFC822Name,
        "IP": lambda address: x509.IPAddress(ipaddress.ip_address(address)),
        "RID": lambda dotted: x509.RegisteredID(_oid(dotted)),
    }
    maker = _one_of(kind, makers)
    if not text:
        raise ValueError(f"nothing follows {kind}:")
    if not text.isascii():
        raise ValueError(f"{text!r} is not ASCII")
    return maker(text)


def _distribution_point(item: str) -> x509.DistributionPoint:
    return x509.DistributionPoint([_general_name(item)], None, None, None)


def _access_description(item: str) -> x509.AccessDescription:
    method, _, location = (part.strip() for part in item.partition(";"))
    return x509.AccessDescription(_one_of(method, _ACCESS_METHODS), _general_name(location))


def _subject_key_identifier(text: str, context: Context) -> x509.SubjectKeyIdentifier | None:
    if text == "none":
        return None
    if text == "hash":
        return x509.SubjectKeyIdentifier.from_public_key(context.public_key)  # RFC 5280, 4.2.1.2, method 1
    return x509.SubjectKeyIdentifier(_hex(text))


def _authority_key_identifier(text: str, context: Context) -> x509.AuthorityKeyIdentifier | None:
    if text == "none":
        return None
    identifiers = {item.removesuffix(":always") for item in _items(text)}
    if not identifiers <= {"keyid", "issuer"}:
        raise ValueError("expected keyid, issuer (each perhaps with :always) or none")
    if context.issuer is None:
        return x509.AuthorityKeyIdentifier.from_issuer_public_key(context.public_key)
    identifier, named = authority_key_identifier(context.issuer).key_identifier, "issuer" in identifiers
    return x509.AuthorityKeyIdentifier(
        identifier if "keyid" in identifiers else None,
        [x509.DirectoryName(context.issuer.issuer)] if named else None,
        context.issuer.serial_number if named else None,
    )


def _string(kind: str, text: str) -> bytes:
    tag, encoding = _one_of(kind, _ASN1_STRINGS)
    return der.tlv(tag, text.encode(encoding))


def _hex(text: str) -> bytes:
    try:
        content = bytes.fromhex(text.replace(":", ""))
    except ValueError:
        raise ValueError(f"{quote(text, 40)} is not hexadecimal") from None
    if not content:
        raise ValueError("no hexadecimal digits")
    return content


def _raw(text: str) -> bytes:
    """Return the DER of ``DER:hex`` or ``ASN1:type:text``: exactly one element."""
    form, _, rest = text.partition(":")
    if form == "ASN1":
        kind, _, rest = rest.partition(":")
        return _string(kind, rest)
    if form != "DER":
        raise ValueError("expected DER:hexadecimal or ASN1:UTF8String:text")
    content = _hex(rest)
    if len(der.elements(content)) != 1:
        raise ValueError("not one DER element")
    return content


def _of_entries(kind: Any, read: Callable[[str], object]) -> tuple[x509.ObjectIdentifier, _Reader]:
    """Return the OID and the reader of a kind of extension that has a list, by what reads one entry of it."""
    return kind.oid, lambda text, _: kind(map(read, _items(text)))


_KNOWN: dict[str, tuple[x509.ObjectIdentifier, _Reader]] = {
    "basicConstraints": (ExtensionOID.BASIC_CONSTRAINTS, _basic_constraints),
    "keyUsage": (ExtensionOID.KEY_USAGE, lambda text, _: key_usage(*_items(text))),
    "extendedKeyUsage": _of_entries(x509.ExtendedKeyUsage, _extended_key_usage),
    "subjectAltName": _of_entries(x509.SubjectAlternativeName, _general_name),
    "issuerAltName": _of_entries(x509.IssuerAlternativeName, _general_name),
    "certificatePolicies": _of_entries(x509.CertificatePolicies, _policy),
    "crlDistributionPoints": _of_entries(x509.CRLDistributionPoints, _distribution_point),
    "authorityInfoAccess": _of_entries(x509.AuthorityInformationAccess, _access_description),
    "subjectKeyIdentifier": (ExtensionOID.SUBJECT_KEY_IDENTIFIER, _subject_key_identifier),
    "authorityKeyIdentifier": (ExtensionOID.AUTHORITY_KEY_IDENTIFIER, _authority_key_identifier),
    "nsComment": (_NS_COMMENT, lambda text, _: x509.UnrecognizedExtension(_NS_COMMENT, _string("IA5", text))),
}
