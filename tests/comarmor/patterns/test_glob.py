# SPDX-License-Identifier: Apache-2.0
"""Patterns match as the C library does, whatever their shape, in polynomial time; partial derivatives are exact."""

from __future__ import annotations

import ctypes
import ctypes.util
import re
from functools import cache

import pytest
from hypothesis import example, given, strategies as st

from comarmor.patterns import glob
from comarmor.patterns.glob import matcher, matches, parse, regex
from comarmor.patterns.tokens import ANY, STAR, PatternError, Star

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


TOKENS = ["a", "b", "ab", ".", "\n", "*", "?", "[ab]", "[!a]", "[b-a]", "[!b-a]", "[.-]"]
PATTERNS = st.lists(st.sampled_from(TOKENS), max_size=6).map("".join).map(parse)
NAMES = st.text("ab.\n-é", max_size=6)


@cache
def by_definition(pattern, name):
    """Return whether a pattern matches a name: try every length for each ``*``."""
    if not pattern:
        return not name
    token, *rest = pattern
    rest = tuple(rest)
    if isinstance(token, Star):
        return any(by_definition(rest, name[length:]) for length in range(len(name) + 1))
    if isinstance(token, str):
        return name.startswith(token) and by_definition(rest, name[len(token) :])
    return bool(name) and name[0] in token and by_definition(rest, name[1:])


@given(PATTERNS, NAMES)
@example(parse("ab*ba"), "aba")
@example(parse("a*a"), "a")
@example(parse("*ab*"), "b")
@example(parse("?"), "\n")
@example(parse("*a?*b"), "aab")
def test_every_shape_matches_by_definition(pattern, name):
    expected = by_definition(pattern, name)
    assert matches(pattern, name) is expected
    assert matcher(pattern)(name) is expected
    assert (re.fullmatch(regex(pattern), name, re.DOTALL) is not None) is expected


@pytest.mark.parametrize("pattern", ["*a" * 30 + "b", "*?a" * 30 + "*b", "*[ab]" * 30 + "c", "a*" * 30 + "b"])
def test_backtracking_does_not_explode(pattern):
    assert not matches(parse(pattern), "a" * 3000)
