# SPDX-License-Identifier: Apache-2.0
"""URIs of keys in PKCS #11 tokens (RFC 7512): ``pkcs11:token=ca;object=identity_ca?pin-source=file:/etc/ca.pin``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from urllib.parse import unquote, unquote_to_bytes

from comarmor.text import did_you_mean, lazy_regex, quote
from comarmor.values import Data
from keymint.errors import KeymintError, Origin

CODE = "pkcs11-uri"
"""Code of all errors here."""
_TOKEN = ("token", "serial", "manufacturer", "model", "slot-id", "slot-description", "slot-manufacturer")
_OBJECT = ("object", "id", "type")
_QUERY = ("module-path", "pin-source")
_PATH_TEXT = lazy_regex(r"(?:[A-Za-z0-9\-._~:\[\]@!$'()*+,=&]|%[0-9A-Fa-f]{2})+")
_QUERY_TEXT = lazy_regex(r"(?:[A-Za-z0-9\-._~:\[\]@!$'()*+,=/?|]|%[0-9A-Fa-f]{2})+")
"""Names and values of attributes (RFC 7512, 2.3: pk11-pchar and pk11-qchar)."""
_MOST = 4096


class Pkcs11Uri(Data):
    """A private key in a token.

    Attributes:
        text: the URI as given.
        token: what identifies the token and its slot, by the names of RFC 7512; not empty.
        label: label of the object (CKA_LABEL), or empty.
        id: identifier of the object (CKA_ID), or empty.
        module_path: absolute path of the module that reaches the token, or empty.
        pin_file: absolute path of the file that has the PIN, or empty.
    """

    text: str
    token: Mapping[str, str]
    label: str = ""
    id: bytes = b""
    module_path: str = ""
    pin_file: str = ""

    @property
    def path(self) -> str:
        """The URI without module and PIN file: what it identifies, for messages and for files that name a key."""
        return self.text.partition("?")[0]


def parse(text: str, where: Origin | None = None) -> Pkcs11Uri:
    """Read the URI of a private key.

    Args:
        text: the URI.
        where: the place that names it, for messages.

    Raises:
        KeymintError: ``pkcs11-uri``: not a URI of RFC 7512, or one that does not say which key of which token it is, or
            one that contains the PIN.
    """
    if "pin-value" in text.lower():  # before anything else, so that no message shows the PIN
        raise _error(
            "the URI contains the PIN, which everybody who reads this file would know",
            where,
            "leave pin-value out; name the PIN's environment variable in <pin_env>, or its file: pin-source=file:/path",
        )
    if not text.startswith("pkcs11:") or len(text) > _MOST:
        raise _error(f"{quote(text, 80)} is not a PKCS #11 URI", where, "write pkcs11:token=…;object=… (RFC 7512)")
    path, _, query = text.removeprefix("pkcs11:").partition("?")
    found = _attributes(path, ";", (*_TOKEN, *_OBJECT), _PATH_TEXT, where)
    asked = _attributes(query, "&", _QUERY, _QUERY_TEXT, where)
    token = {name: _text(found[name], where) for name in _TOKEN if name in found}
    if not token:
        raise _error("the URI does not say which token it is", where, "add token=LABEL or serial=NUMBER")
    if "object" not in found and "id" not in found:
        raise _error("the URI does not say which key of the token it is", where, "add object=LABEL or id=%01")
    if found.get("type", "private") != "private":
        raise _error(f"the URI is of type {found['type']!r}", where, "write type=private, or leave it out")
    if not token.get("slot-id", "0").isdecimal():
        raise _error(f"slot-id={token['slot-id']} is not a number", where, "token=LABEL lasts longer than a slot")
    module = _text(asked.get("module-path", ""), where)
    if module and not module.startswith("/"):
        raise _error(f"module-path={module} is not an absolute path", where, "begin it with a slash")
    return Pkcs11Uri(
        text, token, _text(found.get("object", ""), where), unquote_to_bytes(found.get("id", "")), module,
        _pin_file(_text(asked.get("pin-source", ""), where), where),
    )  # fmt: skip


def _attributes(
    text: str, separator: str, known: tuple[str, ...], form: re.Pattern[str], where: Origin | None
) -> dict[str, str]:
    """Return the attributes of one part of a URI by name, still percent-encoded."""
    found: dict[str, str] = {}
    for part in text.split(separator) if text else ():
        name, equals, value = part.partition("=")
        if not equals or not form.fullmatch(part):
            raise _error(f"the URI has {quote(part, 80)}, expected name=value", where, "write a blank as %20")
        if name not in known:
            # An attribute that is not understood identifies no object (RFC 7512, 2.3).
            raise _error(
                f"the URI has an attribute {name!r} that is not supported", where, did_you_mean(name, known, "")
            )
        if name in found:
            raise _error(f"the URI has two attributes {name!r}", where, "leave one of them out")
        found[name] = value
    return found


def _text(value: str, where: Origin | None) -> str:
    try:
        text = unquote(value, errors="strict")
    except UnicodeDecodeError:
        raise _error(f"{quote(value, 80)} is not UTF-8", where, "only id may have other bytes") from None
    if "\0" in text:
        raise _error(f"{quote(value, 80)} has a NUL", where, "leave it out")
    return text


def _pin_file(source: str, where: Origin | None) -> str:
    """Return the path of a PIN file: ``file:/path``, ``file:///path`` or ``/path`` (RFC 7512, 2.4)."""
    path = source.removeprefix("file:")
    path = path.removeprefix("//") if path.startswith("///") else path
    if path and not (path.startswith("/") and not path.startswith("//")):
        raise _error(f"pin-source={quote(source, 80)} is not a file", where, "write pin-source=file:/absolute/path")
    return path


def _error(message: str, where: Origin | None, help_: str) -> KeymintError:
    return KeymintError(message, where=where, help=help_, code=CODE)
