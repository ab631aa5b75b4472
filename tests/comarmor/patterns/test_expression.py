# SPDX-License-Identifier: Apache-2.0
"""Expressions of policies; the oracle is ``fnmatch()`` of the C library."""

from __future__ import annotations

import ctypes

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from comarmor.errors import ComArmorError
from comarmor.patterns import expression
from comarmor.patterns.printing import canonical, escape
from tests.effort import tries

LIBC = ctypes.CDLL(None)

ATOMS = ("*", "?", "a", "b", "z", "/", "-", "!", "^", ".", ":", "{", "}", "]", "[ab]", "[!a]", "[^b-z]", "[]a]", "[a-]")
MORE = (
    "[!]-a]",
    "[[:alpha:]]",
    "[![:digit:]_]",
    "[[:punct:]]",
    "\\*",
    "\\[",
    "\\\\",
    "[\\]x]",
    "[a\\-z]",
    "[--0]",
    "[",
)
PATTERNS = st.lists(st.sampled_from(ATOMS + MORE), max_size=7).map("".join)
NAMES = st.text(alphabet="abz/-!^.:{}][*\\_0", max_size=8)


def fnmatch(pattern: str, name: str) -> bool:
    """Match by the C library, in the C locale, in which a byte is a character."""
    return LIBC.fnmatch(pattern.encode("latin-1"), name.encode("latin-1"), 0) == 0


@settings(max_examples=tries(250, 1500), deadline=None)
@given(PATTERNS, NAMES)
@example("[a", "[a")
@example("[!]", "[!]")
@example("[[:alpha:]", "[a")
@example("[a-c-e]", "-")
@example("*[", "x[")
@example("*", "")
def test_matches_what_the_c_library_matches(pattern: str, name: str) -> None:
    assume(not pattern.endswith(("[a-", "-")))  # glibc reads a range in a bracket that is never closed
    try:
        found = expression.matches(pattern, name)
    except ComArmorError:
        assume(False)
    assert found == fnmatch(pattern, name)


@given(PATTERNS, NAMES)
def test_canonical_notation_means_the_same(pattern: str, name: str) -> None:
    try:
        notation = canonical(expression.parse(pattern))
    except ComArmorError:
        return
    assert expression.matches(notation, name) == expression.matches(pattern, name)
    assert canonical(expression.parse(notation)) == notation


@given(st.text(max_size=12), st.text(max_size=12))
def test_escaped_text_matches_only_itself(text: str, other: str) -> None:
    escaped = escape(text)
    assert expression.literal(escaped) == text
    assert expression.matches(escaped, text)
    assert expression.matches(escaped, other) == (text == other)


def test_wildcards_match_slashes() -> None:
    assert expression.matches("*/talker", "/a/b/talker")
    assert expression.matches("/a?b", "/a/b")
    assert not expression.matches("/a", "/a\n")
    assert expression.matches("/a*", "/a\nb")


def test_text_beyond_ascii_is_compared_by_code_points() -> None:
    assert expression.matches("/?", "/é")
    assert expression.matches("[à-ï]", "é")
    assert not expression.matches("[[:alpha:]]", "é")
    assert expression.matches("?", "\U0001f600")


def test_literals() -> None:
    assert expression.literal("/talker") == "/talker"
    assert expression.literal("/a\\*b") == "/a*b"
    assert expression.literal("/a*") is None
    assert expression.literal("[a]") is None
    assert expression.literal("?") is None


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("a\\", "lone"),
        ("[[:alhpa:]]", "did you mean 'alpha'?"),
        ("[[:ALPHA:]]", "did you mean 'alpha'?"),
        ("[[.a.]]", "collating element"),
        ("[[=a=]]", "equivalence class"),
        ("[z-a]", "range z-a is empty"),
        ("[a-[:digit:]]", "cannot end a range"),
        ("[a-[:digit:]", "cannot end a range"),
    ],
)
def test_what_has_no_meaning_is_refused(pattern: str, message: str) -> None:
    with pytest.raises(ComArmorError, match=message.replace("?", "\\?")):
        expression.matches(pattern, "x")


@pytest.mark.parametrize("pattern", ["*a" * 40 + "b", "*?a" * 40 + "b", "*[ab]*" * 40 + "c", "*" * 4000 + "b"])
def test_no_expression_takes_exponential_time(pattern: str) -> None:
    assert not expression.matches(pattern, "a" * 2000)  # or this would never end
