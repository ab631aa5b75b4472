# SPDX-License-Identifier: Apache-2.0
"""Messages about files that are not well-formed XML, each with a remedy."""

from __future__ import annotations

import gzip

import pytest

from comarmor.errors import ComArmorError, Diagnostic
from comarmor.xml.reader import parse

DOCUMENT = "<profiles>\n  <profile/>\n</profiles>\n"


def said(content: bytes) -> Diagnostic:
    with pytest.raises(ComArmorError) as raised:
        parse(content, "p.xml")
    (diagnostic,) = raised.value.diagnostics
    assert diagnostic.help
    return diagnostic


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "a picture"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "a picture"),
        (b"%PDF-1.7\n", "a PDF document"),
        (gzip.compress(DOCUMENT.encode(), mtime=0), "a compressed file"),
        (b"PK\x03\x04\n", "a compressed file"),
        (b"SQLite format 3\0", "an SQLite database"),
        (b"-----BEGIN CERTIFICATE-----\n", "a key, a certificate or a signature in PEM"),
        (b"MIME-Version: 1.0\n", "a signed document (S/MIME)"),
        (b"#!/bin/sh\n", "a script"),
        (b'{"profiles": []}', "JSON"),
        (b"camera:\n  publish: [image]\n", "YAML"),
        (b"# my robot\n\n---\n- camera\n", "YAML"),
        (b"- camera\n", "YAML"),
    ],
)
def test_a_file_that_is_not_xml_is_named(content: bytes, what: str) -> None:
    diagnostic = said(content)
    assert (diagnostic.code, diagnostic.message) == ("xml-syntax", f"the file is not XML: it looks like {what}")


@pytest.mark.parametrize("content", [b"\x7fELF\x02", b"# My robot", b"hello", b"\xff\xfe", bytes(range(255, 0, -1))])
def test_what_nothing_is_known_about_is_not_xml(content: bytes) -> None:
    assert said(content).message == "the file is not XML: it does not begin with '<'"


@pytest.mark.parametrize("content", [b"", b" \n", b"\xef\xbb\xbf"])
def test_an_empty_file(content: bytes) -> None:
    assert said(content).message == "the file is not XML: it is empty"


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-32", "utf-32-le"])
def test_an_encoding_of_several_bytes_that_nothing_tells(encoding: str) -> None:
    assert said(DOCUMENT.encode(encoding)).code == "xml-encoding"


def test_a_declared_encoding_that_is_not_true() -> None:
    declared = f'<?xml version="1.0" encoding="UTF-8"?>\n{DOCUMENT}'
    assert said(declared.encode("utf-16")).help == "save the file as UTF-8"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_encodings_that_are_told_are_read(encoding: str) -> None:
    assert parse(DOCUMENT.encode(encoding), "p.xml").tag == "profiles"


@pytest.mark.parametrize("declared", ["", '<?xml version="1.0"?>\n', '<?xml version="1.0" encoding="utf-8"?>\n'])
def test_a_byte_that_is_not_utf_8_has_its_line(declared: str) -> None:
    content = f"{declared}<profiles>\n<profile name='café'/></profiles>".encode("latin-1")
    diagnostic = said(content)
    assert (diagnostic.code, diagnostic.where and diagnostic.where.line) == ("xml-encoding", declared.count("\n") + 2)
    assert diagnostic.message == "the byte 0xe9 is not UTF-8"


@pytest.mark.parametrize(
    ("content", "remedy"),
    [
        ("<a>x & b</a>", "write & as &amp;"),
        ("<a>x &b</a>", "write & as &amp;"),
        ("<a>&nbsp;</a>", "write the character itself; only &amp; &lt; &gt; &quot; &apos; are known"),
        ("<a>x < b</a>", "write < as &lt;; a tag begins with a letter"),
        ("<a q='<'/>", "write < as &lt;; a tag begins with a letter"),
        ("<a q=ALLOW/>", 'write the value in straight quotes: name="value"'),
        ("<a q=\u201cALLOW\u201d/>", 'write the value in straight quotes: name="value"'),
        ("<a q/>", 'give the attribute a value: name="value"'),
        ('<a q="1"r="2"/>', "separate attributes with a blank"),
        ('<a q="1" q="2"/>', "remove one of the two"),
        ("<a><!-- x -- y --></a>", "a comment may not contain --"),
        ("<a>]]></a>", "write > as &gt;"),
        ("<a>\f</a>", "remove the control character"),
        ("<a>&#0;</a>", "remove it: XML has no such character"),
        ("</a>", "remove the end tag, or add what it ends"),
        ("<a/>\n<b/>", "a file has one root element: move what follows it into it"),
        ('\n<?xml version="1.0"?><a/>', "remove all that stands before <?xml …?>, also empty lines"),
        ('<a q="x/>', "add the missing > or quote, or the end of the comment: -->"),
        ("<!-- x -->", "add the root element; that of a policy is <profiles>"),
        ("<a>\n<b>\n</a>", "add </b>, or correct the tag"),
        ("<a>\n<b>\n</b>", "add </a>, or correct the tag"),
    ],
)
def test_what_newcomers_write(content: str, remedy: str) -> None:
    assert said(content.encode()).help == remedy
