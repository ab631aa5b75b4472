# SPDX-License-Identifier: Apache-2.0
"""What makes vendors read a document differently from a plain one."""

from __future__ import annotations

import re
from unittest import mock

import pytest
from hypothesis import assume, given, strategies as st
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.dialects import PLAIN, REFUSES, UNMODELLED
from lxml import etree

from tests.plugins.keymint_ros2_dds.decision import documents

CONTENT = documents.PLAIN
PARTS = CONTENT.split(b"\n")


def summary(content: bytes, **options: int) -> list[tuple[int, str]]:
    return [(each.line, each.text) for each in dialects.quirks_of_bytes(content, **options)]


def test_a_plain_document_has_none() -> None:
    root = etree.fromstring(CONTENT)
    assert summary(CONTENT) == []
    assert list(dialects.quirks_of_domain_ids(root)) == []
    assert dialects.quirks_by_schema(root, "permissions", "p.xml") == ((), ())


@given(st.lists(st.sampled_from([b"<!-- c -->", b"<!-- <x > &#1; -->", b"\n", b" "]), max_size=4), st.integers(0, 99))
def test_comments_between_elements_only_move_lines(blanks: list[bytes], at: int) -> None:
    between = at % len(PARTS)
    odd = [part.replace(b"</publish>", b"</publish >") for part in PARTS]
    content = b"\n".join([*odd[:between], b"".join(blanks), *odd[between:]])
    line = content[: content.index(b"</publish >")].count(b"\n") + 1
    assert summary(content) == [(line, "white space in an end tag")]


USUAL = CONTENT.replace(b"<dds", f'{dialects.USUAL_HEAD}x"'.encode())
ODD = [b"<!-- c -->", b"<![CDATA[x]]>", b"<?x y?>", b"&#65;", b"&lt;", b" ", b"\t", b"\n", b" xmlns:x='y'"]


@given(st.sampled_from(ODD), st.sampled_from([each.start() for each in re.finditer(b"[<>]", USUAL)]))
def test_a_document_without_quirks_in_the_usual_form_is_known_at_once(odd: bytes, at: int) -> None:
    content = USUAL[:at] + odd + USUAL[at:]
    try:
        etree.fromstring(content)
    except etree.XMLSyntaxError:
        assume(False)
    found = summary(content)
    with mock.patch.object(dialects, "USUAL_HEAD", "none"):
        assert summary(content) == found


def test_comments_count_from_an_offset_on() -> None:
    content = CONTENT.replace(b"</permissions>", b"<!-- c -->\n</permissions>")
    assert summary(content) == summary(content, comments_until=len(content)) == []
    (found,) = summary(content, comments_until=10)
    assert found == (
        content[: content.index(b"<!--")].count(b"\n") + 1,
        "a comment in a text, a CDATA section or a processing instruction",
    )


@pytest.mark.parametrize(
    ("declaration", "known"),
    [
        (b'<?xml version="1.0"?>', True),
        (b"<?xml version='1.0' encoding='us-ascii'?>", True),
        (b'<?xml version="1.0" encoding="windows-1252"?>', True),
        (b'<?xml version="1.0" encoding="EBCDIC"?>', False),
    ],
)
def test_encodings(declaration: bytes, known: bool) -> None:
    found = list(dialects.quirks_of_bytes(declaration + CONTENT))
    assert [(each.cyclone, each.fast) for each in found] == ([] if known else [(UNMODELLED, UNMODELLED)])


def test_the_declaration_may_have_lines() -> None:
    content = b'<?xml version="1.0"\n\n?>' + CONTENT.replace(b"</publish>", b"</publish >")
    ((line, _),) = summary(content)
    assert line == content[: content.index(b"</publish >")].count(b"\n") + 1


@pytest.mark.parametrize(
    ("text", "cyclone", "fast"),
    [("0", None, None), (" 230\n", None, None), ("231", REFUSES, PLAIN), ("+1", UNMODELLED, UNMODELLED)],
)
@pytest.mark.parametrize("tag", ["id", "min", "max"])
def test_domain_ids(tag: str, text: str, cyclone: object, fast: object) -> None:
    root = etree.fromstring(f"<domains>\n<{tag}>{text}</{tag}></domains>")
    found = [(each.line, each.cyclone, each.fast) for each in dialects.quirks_of_domain_ids(root)]
    assert found == ([] if cyclone is None else [(2, cyclone, fast)])


@given(st.text(st.sampled_from("0129+-_ \u0663\u00b2"), max_size=12))
def test_numbers_are_ascii_digits(text: str) -> None:
    assert dialects.is_number(text) == (re.fullmatch("[0-9]+", text) is not None)
    root = etree.fromstring(f"<domains><id>x{text}</id></domains>")
    root[0].text = text
    is_plain = re.fullmatch("0|[1-9][0-9]{0,8}", text.strip(" ")) is not None
    assert is_plain == all(each.cyclone == REFUSES for each in dialects.quirks_of_domain_ids(root))


def test_what_the_schema_does_not_allow_is_an_error_and_a_quirk() -> None:
    root = etree.fromstring(CONTENT.replace(b"<default>DENY</default>", b"\n<default>MAYBE</default>"))
    (defect, *_), (quirk,) = dialects.quirks_by_schema(root, "permissions", "p.xml")
    assert str(defect.where) == f"p.xml:{quirk.line}"
    assert defect.message in quirk.text
    assert (quirk.cyclone, quirk.fast) == (UNMODELLED, UNMODELLED)
    assert dialects.quirks_by_schema(root, "governance", "g.xml")[0]
