# SPDX-License-Identifier: Apache-2.0
"""Text of messages: escaped, quoted, counted, with suggestions."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest
from hypothesis import given, strategies as st

from comarmor.text import did_you_mean, encodable_value, first_few, hexadecimal, nearest_word, one_line, quantity, quote

ANY = st.text(st.characters(codec=None))


@given(ANY)
def test_printable_text_is_one_printable_line(text: str) -> None:
    assert one_line(text).isprintable()


@given(ANY)
def test_encodable_text_has_a_form_in_utf_8(text: str) -> None:
    json.dumps(encodable_value({text: [text]}), ensure_ascii=False).encode()


def test_moments_are_written_in_iso_8601() -> None:
    moment = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
    assert encodable_value({"at": (moment,), "end": None}) == {"at": ["2026-01-02T03:04:05+00:00"], "end": None}


@given(ANY, st.integers(1, 100))
def test_quoted_text_has_a_limit(text: str, limit: int) -> None:
    assert len(quote(text, limit)) <= limit + 3


@pytest.mark.parametrize(("number", "text"), [(0, "no edges"), (1, "1 edge"), (2, "2 edges")])
def test_numbers_with_nouns(number: int, text: str) -> None:
    assert quantity(number, "edge") == text


def test_suggestions_ignore_case() -> None:
    assert did_you_mean("keyusage", ["keyUsage"]) == "did you mean 'keyUsage'?"
    assert did_you_mean("x", ["keyUsage"], "known are keyUsage") == "known are keyUsage"
    assert nearest_word("keyUsag", ["keyUsage", "other"]) == "keyUsage"
    assert nearest_word("x" * 10_000, ["y" * 10_000]) == ""


def test_the_first_of_many() -> None:
    assert first_few(["a", "b"], 2) == "a, b"
    assert first_few(["a", "b", "c"], 2) == "a, b, …"


@pytest.mark.parametrize(("number", "text"), [(0, "00"), (10, "0a"), (0x1B, "1b"), (0x123, "0123")])
def test_a_serial_number_has_whole_bytes(number: int, text: str) -> None:
    assert hexadecimal(number) == text
