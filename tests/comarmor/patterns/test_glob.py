# SPDX-License-Identifier: Apache-2.0
"""Patterns match as the C library does, and partial derivatives are exact."""

from __future__ import annotations

import ctypes
import ctypes.util

import pytest
from hypothesis import given
from hypothesis import strategies as st

from comarmor.patterns import glob
from comarmor.patterns.matching import matches
from comarmor.patterns.tokens import ANY, STAR, PatternError

PIECES = st.sampled_from([*"ab/]-^!\\[", "*", "?", "[ab]", "[!a]", "[a-b]", "[]a]", "[!]]", "[[:alpha:]]", "[\\]a]"])
EXPRESSIONS = st.lists(PIECES, max_size=5).map("".join)
TEXTS = st.text(alphabet="ab/]-^!\\[c", max_size=5)


@pytest.fixture(scope="module")
def fnmatch():
    return ctypes.CDLL(ctypes.util.find_library("c")).fnmatch


@given(expression=EXPRESSIONS, text=TEXTS)
def test_an_expression_matches_what_fnmatch_of_the_c_library_matches(fnmatch, expression, text):
    try:
        tokens = glob.parse(expression)
    except PatternError:
        assert expression.endswith("\\")
        return
    assert matches(tokens, text) == (fnmatch(expression.encode(), text.encode(), 0) == 0)


@pytest.mark.parametrize(
    ("expression", "name", "matched"),
    [
        ("/a*", "/a/b/c", True),
        ("?b", "éb", True),
        ("[[:digit:][:upper:]]", "7", True),
        ("[[:digit:][:upper:]]", "Q", True),
        ("[[:digit:][:upper:]]", "q", False),
        ("[a-]", "-", True),
        ("[^a]", "b", True),
        ("[b-a]", "a", False),
        ("a[", "a[", True),
        ("", "", True),
        ("*", "", True),
        (r"\*", "*", True),
        (r"\*", "x", False),
        ("*a*a*a*a*a*a*a*a*a*b", "a" * 2000, False),
        ("[[:blank:][:space:]]", "\t", True),
    ],
)
def test_examples(expression, name, matched):
    assert matches(glob.parse(expression), name) is matched


@pytest.mark.parametrize("expression", ["a\\", "[[:nope:]]", "[[=a=]]", "[[.hyphen.]]"])
def test_what_has_no_meaning_is_refused(expression):
    with pytest.raises(PatternError, match=r"lone|class|collating"):
        glob.parse(expression)


def test_tokens_are_normalised():
    assert glob.parse("**") == (STAR,)
    assert glob.parse("*?*?") == (ANY, ANY, STAR)
    assert glob.parse(r"a\*[b]") == ("a*b",)
    assert glob.parse("[ba]") == glob.parse("[a-b]")


@given(expression=EXPRESSIONS, prefix=st.text(alphabet="ab/", max_size=3), text=TEXTS)
def test_derivatives_are_exact(expression, prefix, text):
    try:
        tokens = glob.parse(expression)
    except PatternError:
        return
    assert any(matches(rest, text) for rest in glob.left_quotient(tokens, prefix)) == matches(tokens, prefix + text)
    assert any(matches(rest, text) for rest in glob.right_quotient(tokens, prefix)) == matches(tokens, text + prefix)


@given(expression=EXPRESSIONS, text=TEXTS)
def test_surround_adds_literal_text(expression, text):
    try:
        tokens = glob.parse(expression)
    except PatternError:
        return
    assert matches(glob.surround("x*", tokens, "y"), f"x*{text}y") == matches(tokens, text)
    assert not matches(glob.surround("x*", tokens, "y"), f"xx{text}y")
