# SPDX-License-Identifier: Apache-2.0
"""XML documents are read with limits, without DOCTYPE, and with exact places."""

from __future__ import annotations

import gc

import pytest

from comarmor.errors import ComArmorError, Diagnostic
from comarmor.xml.reader import Limits, looks_like_xml, parse, place
from tests.effort import calls_of


def refused(content: bytes) -> Diagnostic:
    def attempt() -> Diagnostic:
        with pytest.raises(ComArmorError) as caught:
            parse(content, "p.xml")
        return caught.value.diagnostics[0]

    diagnostic, calls = calls_of(attempt)
    assert calls < 100_000
    return diagnostic


ENTITIES = "".join(f'<!ENTITY a{i} "{10 * "&a%d;"}">' % ((i - 1,) * 10) for i in range(1, 20))


@pytest.mark.parametrize(
    "text",
    [
        f'<!DOCTYPE a [<!ENTITY a0 "ha">{ENTITIES}]><profiles>&a19;</profiles>',
        '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><profiles>&x;</profiles>',
        '<!DOCTYPE a [<!ENTITY % x SYSTEM "http://127.0.0.1:9/x"> %x;]><profiles/>',
        '<!DOCTYPE profiles SYSTEM "http://127.0.0.1:9/x.dtd"><profiles/>',
        "<!DOCTYPE profiles><profiles/>",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_doctype_is_refused_before_it_is_read(text: str, encoding: str) -> None:
    diagnostic = refused(text.encode(encoding))
    assert (diagnostic.code, diagnostic.where.line) == ("xml-doctype", 1)


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"", "xml-syntax"),
        (b"<profiles>", "xml-syntax"),
        (b"<profiles></profile>", "xml-syntax"),
        (b"<profiles>&x;</profiles>", "xml-syntax"),
        (b"<profiles>\x00</profiles>", "xml-syntax"),
        (b"<profiles>\xff</profiles>", "xml-encoding"),
        (b"\x7fELF", "xml-syntax"),
        (b"<?xml version='1.0' encoding='utf-7'?><profiles/>", "xml-encoding"),
        (b"<?xml version='1.0' encoding='no-such'?><profiles/>", "xml-encoding"),
        (b"<a>" * 100_000, "xml-limit"),
    ],
)
def test_not_plain_xml(content: bytes, code: str) -> None:
    assert refused(content).code == code


def test_end_tag_says_what_it_should_close() -> None:
    diagnostic = refused(b"<profiles>\n<profile>\n</profiles>")
    assert "expected the end of <profile>, which begins on line 2" in diagnostic.message
    assert diagnostic.where.line == 3


def test_limits() -> None:
    small = Limits(file_bytes=100, nodes=3)
    with pytest.raises(ComArmorError, match="100 bytes"):
        parse(b"<a>" + b" " * 100 + b"</a>", "x", limits=small)
    with pytest.raises(ComArmorError, match="3 elements"):
        parse(b"<a><b/><b/><b/></a>", "x", limits=small)
    assert parse(b"<a><b/><b/></a>", "x", limits=small).tag == "a"


def test_places_are_exact_beyond_16_bits() -> None:
    root = parse(b"<a>" + b"\n" * 70_000 + b"  <b\n/></a>", "x")
    assert place(root[0]) == (70_001, 3)


def is_element(thing: object) -> bool:
    return type(thing).__name__ == "_Element"


def test_a_tree_ends_with_its_last_use_without_a_search_for_cycles() -> None:
    gc.disable()
    try:
        before = sum(map(is_element, gc.get_objects()))
        root = parse(b"<profiles><profile><attachment/></profile></profiles>", "p.xml")
        assert place(root[0]) == (1, 11)
        assert sum(map(is_element, gc.get_objects())) == before + 3
        del root
        assert sum(map(is_element, gc.get_objects())) == before
    finally:
        gc.enable()


def test_schema_locations_are_removed() -> None:
    xsi = "http://www.w3.org/2001/XMLSchema-instance"
    root = parse(f'<a xmlns:xsi="{xsi}" xsi:noNamespaceSchemaLocation="http://127.0.0.1:9/x.xsd"/>'.encode(), "x")
    assert not root.attrib


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
def test_what_looks_like_xml(encoding: str) -> None:
    assert looks_like_xml("\r\n <a".encode(encoding))
    for text in ("", "a,<b>", "{}"):
        assert not looks_like_xml(text.encode(encoding))
