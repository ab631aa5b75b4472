# SPDX-License-Identifier: Apache-2.0
"""The frame of signed documents: what is wrapped is unwrapped, also with other line ends, and nothing else is."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki import smime
from keymint.pki.smime import UNREAD, SignedDocument, canonical_text, refuse, unwrap, wrap
from tests.effort import tries

CONTENTS = st.text(st.characters(exclude_characters="\0\r", exclude_categories=["Cs"]), max_size=200).map(str.encode)
SIGNATURES = st.binary(min_size=1, max_size=200)


@given(CONTENTS, SIGNATURES, st.booleans())
def test_what_is_wrapped_is_unwrapped_with_either_line_end(content: bytes, signature: bytes, crlf: bool) -> None:
    document = wrap(content, signature)
    assert b"\r" not in document
    parts = unwrap(document.replace(b"\n", b"\r\n") if crlf else document)
    assert (parts.content, parts.signature, parts.digest) == (content, signature, "sha256")
    assert document.split(b"\n")[parts.lines_before] == content.split(b"\n")[0]


@given(CONTENTS, SIGNATURES, SIGNATURES)
def test_the_frame_depends_on_the_content_only(content: bytes, first: bytes, second: bytes) -> None:
    start, other = (
        wrap(content, signature).partition(b"Content-Transfer-Encoding")[0] for signature in (first, second)
    )
    assert start == other


@given(CONTENTS)
def test_the_text_to_sign_has_its_header_and_crlf_line_ends(content: bytes) -> None:
    header, blank, text = canonical_text(content).split(b"\r\n", 2)
    assert (header, blank) == (b"Content-Type: text/plain", b"")
    assert text.replace(b"\r\n", b"\n") == content
    assert text.count(b"\n") == text.count(b"\r\n")


DOCUMENT = wrap(b"<dds>\n</dds>\n", b"signature" * 20)


FRAME = [line for line, text in enumerate(DOCUMENT.split(b"\n")) if b":" in text or b" " in text or b"--" in text]
"""The lines of the frame that are not blank: not the content, and not the base64."""


@pytest.mark.parametrize("line", FRAME)
@pytest.mark.parametrize("change", ["removed", "repeated", "with another end", "longer"])
def test_a_changed_line_of_the_frame_is_refused_with_its_place(line: int, change: str) -> None:
    lines = DOCUMENT.split(b"\n")
    match change:
        case "removed":
            del lines[line]
        case "repeated":
            lines.insert(line, lines[line])
        case "with another end":
            lines[line] += b"\r"
        case _:
            lines[line] += b"x"
    with pytest.raises(KeymintError) as caught:
        unwrap(b"\n".join(lines), Origin("p.p7s"))
    (diagnostic,) = caught.value.diagnostics
    assert diagnostic.code == UNREAD
    assert diagnostic.where is not None
    assert 1 <= diagnostic.where.line <= len(lines)


def test_a_refusal_names_the_line_if_there_is_one() -> None:
    for where, line, place in ((Origin("p.p7s", 9), 3, "p.p7s:3: "), (Origin("p.p7s"), 0, "p.p7s: "), (None, 3, "")):
        with pytest.raises(KeymintError) as caught:
            refuse(where, line, "it is empty")
        assert str(caught.value).startswith(f"{place}is malformed or ambiguous S/MIME: it is empty")


@pytest.mark.parametrize("change", [b"\r\n", b" \n", b"=\n", b"", b"\n\n"])
def test_changed_line_ends_of_the_signature_are_refused(change: bytes) -> None:
    head, blank, encoded = DOCUMENT.partition(b'filename="smime.p7s"\n\n')
    with pytest.raises(KeymintError):
        unwrap(head + blank + encoded.replace(b"\n", change, 1))


# -- the form that Keymint writes is read faster, and gives what reading line by line gives ----------------------------

PIECES = (
    *(DOCUMENT.split(b"\n")[line] for line in FRAME),
    *(b"\n", b"\n\n", b"\r\n", b"\r", b"\0", b"--", b"-", b"=", b"==", b"A", b" ", b"sha-384", b"x-"),
    b"--" + DOCUMENT.partition(b'boundary="')[2][:36],
)


def by_lines(document: bytes) -> SignedDocument | None:
    try:
        return smime._by_lines(document, None)
    except KeymintError:
        return None


def agreed(document: bytes) -> bool:
    """Tell whether both ways of reading give the same, where the faster one gives anything."""
    found = smime._written(document)
    return found is None or found == by_lines(document)


@given(CONTENTS, SIGNATURES)
def test_both_ways_of_reading_give_what_was_wrapped(content: bytes, signature: bytes) -> None:
    document = wrap(content, signature)
    assert smime._written(document) == by_lines(document) == SignedDocument(content, signature, 8, "sha256")


def test_both_ways_of_reading_agree_on_every_changed_byte() -> None:
    for position in range(len(DOCUMENT)):
        head, byte, tail = DOCUMENT[:position], DOCUMENT[position : position + 1], DOCUMENT[position + 1 :]
        assert agreed(head + tail), position
        for other in (byte + byte, b"\n", b"\r", b"-", b"=", bytes([byte[0] ^ 1]), b"\0", byte + b"\n", b"\n" + byte):
            assert agreed(head + other + tail), (position, other)


def test_both_ways_of_reading_agree_on_damaged_documents() -> None:
    chosen, taken = random.Random(27), 0
    for _ in range(tries(3_000, 100_000)):
        document = wrap(
            chosen.choice([b"", b"\n", b"<dds>\n--</dds>\n"]), chosen.randbytes(chosen.choice([1, 47, 48, 60]))
        )
        for _ in range(chosen.randint(1, 2)):
            first, last = sorted(chosen.choices(range(len(document) + 1), k=2))
            last = chosen.choice([first, first + 1, last])
            piece = chosen.choice([*PIECES, document[first:last], b""])
            place = chosen.choice([first, len(document), document.rfind(b"--"), document.find(b"\n\n--")])
            document = document[:place] + piece + document[place + chosen.choice([0, 0, len(piece), last - first]) :]
        assert agreed(document), document
        taken += smime._written(document) is not None
    assert taken > tries(100, 3_000)
