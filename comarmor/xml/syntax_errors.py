# SPDX-License-Identifier: Apache-2.0
"""Say why a file is not well-formed XML, or what it is instead, and how to mend it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.parsers import expat  # nosec - only its error codes are used

from comarmor.errors import ComArmorError, Origin

_DECLARE_XI = 'add xmlns:xi="http://www.w3.org/2001/XInclude" to the root element'
_BEGINNINGS = (
    (rb"\x89PNG|\xff\xd8\xff|GIF8|BM", "a picture"),
    (rb"%PDF", "a PDF document"),
    (rb"PK\x03\x04|\x1f\x8b|BZh|\xfd7zXZ|7z\xbc", "a compressed file"),
    (rb"SQLite format", "an SQLite database"),
    (rb"-----BEGIN", "a key, a certificate or a signature in PEM"),
    (rb"MIME-Version", "a signed document (S/MIME)"),
    (rb"#!", "a script"),
    (rb"\s*[{\[]", "JSON"),
    (rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*(?:---|[\w\"'./-]+ *:\s|- )", "YAML"),
)
"""How files that are not XML begin, and what they are; the first one decides."""
_HEAD = 4096
"""Bytes that are looked at for this."""
_REMEDIES = (
    (rb"(^|\n)<$", rb"<<<<<< ", "resolve the conflict of versions that begins here"),
    (rb"&\w*$", rb"[^;]", "write & as &amp;"),
    (rb"=\s*$", rb"[^\"']", 'write the value in straight quotes: name="value"'),
    (
        rb"<$|=\s*[\"'][^\"'<]*$",
        rb"[^/!?\w]|\d|<",
        "write < as &lt;; a tag begins with a letter",
    ),
    (rb"<$", rb"/", "remove the end tag, or add what it ends"),
    (rb"\w$", rb"\s*/?>", 'give the attribute a value: name="value"'),
    (rb"[\"']$", rb"\w", "separate attributes with a blank"),
    (rb"--$", rb"", "a comment may not contain --"),
    (rb"]]$", rb">", "write > as &gt;"),
    (rb"", rb"[\0-\x1f]", "remove the control character"),
)
"""What stands before and at the byte where the parser gives up, and the remedy; the first one decides."""
_BLANK = b"\xef\xbb\xbf \t\r\n"
_TOKENS = expat.errors.XML_ERROR_INVALID_TOKEN, expat.errors.XML_ERROR_PARTIAL_CHAR
_HELP = {
    expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "a file has one root element: move what follows it into it",
    expat.errors.XML_ERROR_MISPLACED_XML_PI: "remove all that stands before <?xml …?>, also empty lines",
    expat.errors.XML_ERROR_UNDEFINED_ENTITY: "write the character itself; only &amp; &lt; &gt; &quot; &apos; are known",
    expat.errors.XML_ERROR_UNCLOSED_TOKEN: "add the missing > or quote, or the end of the comment: -->",
    expat.errors.XML_ERROR_BAD_CHAR_REF: "remove it: XML has no such character",
    expat.errors.XML_ERROR_NO_ELEMENTS: "add the root element; that of a policy is <profiles>",
    expat.errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "remove one of the two",
}
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
    if not begun and not content.lstrip(_BLANK).startswith(b"<"):
        found = next((what for start, what in _BEGINNINGS if re.match(start, content[:_HEAD])), "")
        message = (
            f"the file is not XML: it looks like {found}"
            if found
            else "the file is not XML: it does not begin with '<'"
        )
        message = message if content.strip(_BLANK) else "the file is not XML: it is empty"
        return ComArmorError(
            message, where=where, help="name an XML file; a policy begins with <profiles>", code="xml-syntax"
        )
    help_ = _HELP.get(name, "")
    if opened and name in (expat.errors.XML_ERROR_TAG_MISMATCH, expat.errors.XML_ERROR_NO_ELEMENTS):
        tag, line = opened[-1][0].rpartition("}")[2], opened[-1][1]
        name, help_ = f"expected the end of <{tag}>, which begins on line {line}", f"add </{tag}>, or correct the tag"
    elif name == expat.errors.XML_ERROR_UNBOUND_PREFIX:
        name = "a prefix of this tag is not declared"
        declared = "declare the prefix with xmlns:… at the root element, or remove it"
        help_ = _DECLARE_XI if re.match(rb"</?xi:", content[at:]) else declared
    elif name == expat.errors.XML_ERROR_INVALID_TOKEN:
        before, after = content[max(at - 200, 0) : at], content[at : at + 20]
        matching = (text for start, end, text in _REMEDIES if re.search(start, before) and re.match(end, after))
        help_ = next(matching, "")
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
