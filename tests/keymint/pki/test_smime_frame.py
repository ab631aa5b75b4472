# SPDX-License-Identifier: Apache-2.0
"""The frame of signed documents: what is wrapped is unwrapped, also with other line ends, and nothing else is."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki.smime import UNREAD, canonical_text, refuse, unwrap, wrap

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
