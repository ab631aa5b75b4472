# SPDX-License-Identifier: Apache-2.0
"""Say why a file is not well-formed XML, or what it is instead, and how to mend it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from importlib import resources
from xml.parsers import expat  # nosec - only its error codes are used

from comarmor.errors import ComArmorError, Origin

_DECLARE_XI = 'add xmlns:xi="http://www.w3.org/2001/XInclude" to the root element'
_BLANK = b"\xef\xbb\xbf \t\r\n"
_HEAD = 4096
"""Bytes of a file that tell what it is."""
_TOKENS = expat.errors.XML_ERROR_INVALID_TOKEN, expat.errors.XML_ERROR_PARTIAL_CHAR
_ZEROS = re.compile(rb"(\xff\xfe|\xfe\xff)?(\0+<|<\0)")


def syntax_error(
    error: expat.ExpatError, content: bytes, at: int, opened: Sequence[tuple[str, int]], where: Origin, *, begun: bool
) -> ComArmorError:
    """Return the error on a document that expat refuses.

    Args:
        error: what expat says.
        content: the document.
        at: the byte where it gave up.
        opened: elements without an end so far, with their lines.
        where: the file, and the line where it gave up.
        begun: an element was read before.
    """
    name = expat.ErrorString(error.code)
    if unreadable := encoding_error(content, where, is_token=name in _TOKENS):
        return unreadable
    known = tomllib.loads(resources.files(__package__).joinpath("syntax_errors.toml").read_text(encoding="utf-8"))
    if not begun and not content.lstrip(_BLANK).startswith(b"<"):
        head = content[:_HEAD].decode("latin-1")
        found = next((each["looks_like"] for each in known["beginning"] if re.match(each["pattern"], head)), "")
        other = "it does not begin with '<'" if content.strip(_BLANK) else "it is empty"
        message = f"it looks like {found}" if found else other
        help_ = "name an XML file, or restore this one; a policy begins with <profiles>"
        return ComArmorError(f"the file is not XML: {message}", where=where, help=help_, code="xml-syntax")
    help_ = known["remedies"].get(name, "")
    if opened and name in (expat.errors.XML_ERROR_TAG_MISMATCH, expat.errors.XML_ERROR_NO_ELEMENTS):
        tag, line = opened[-1][0].rpartition("}")[2], opened[-1][1]
        name, help_ = f"expected the end of <{tag}>, which begins on line {line}", f"add </{tag}>, or correct the tag"
    elif name == expat.errors.XML_ERROR_UNBOUND_PREFIX:
        name = "a prefix of this tag is not declared"
        declared = "declare the prefix with xmlns:… at the root element, or remove it"
        help_ = _DECLARE_XI if re.match(rb"</?xi:", content[at:]) else declared
    elif name == expat.errors.XML_ERROR_INVALID_TOKEN:
        before, after = content[max(at - 200, 0) : at].decode("latin-1"), content[at : at + 20].decode("latin-1")
        slips = (each for each in known["slip"] if re.search(each["before"], before) and re.match(each["at"], after))
        help_ = next((each["remedy"] for each in slips), "")
    return ComArmorError(f"not well-formed XML: {name}", where=where, help=help_, code="xml-syntax")


def encoding_error(content: bytes, where: Origin, *, is_token: bool) -> ComArmorError | None:
    """Return the error on a file in UTF-16 that does not say so, or with bytes that are not UTF-8; None for others.

    Args:
        content: the document.
        where: the file, and the line where the parser gave up.
        is_token: it gave up at a character that is not expected.
    """
    message = "the file is in UTF-16 or UTF-32, and does not say so" if _ZEROS.match(content) else ""
    if is_token and not message and not re.match(rb"\s*<\?xml[^>]*encoding=(?!.utf-?8)", content, re.IGNORECASE):
        try:
            content.decode()
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            if line == where.line and b"<" in content[: error.start]:
                message = f"the byte 0x{content[error.start]:02x} is not UTF-8"
    return ComArmorError(message, where=where, help="save the file as UTF-8", code="xml-encoding") if message else None
