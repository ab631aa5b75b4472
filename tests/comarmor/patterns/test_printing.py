# SPDX-License-Identifier: Apache-2.0
"""Expressions that are written for patterns are read as these patterns."""

from __future__ import annotations

import ctypes

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from comarmor.patterns.glob import parse
from comarmor.patterns.matching import matches
from comarmor.patterns.printing import exact
from comarmor.patterns.tokens import PatternError

PIECES = st.sampled_from([*"ab/]-^!\\[_.", "*", "?", "[ab]", "[!a]", "[a-b]", "[]a]", "[!]]", "[[:alpha:]]", "[\\]a]"])
EXPRESSIONS = st.lists(PIECES, max_size=5).map("".join)
TEXTS = st.text(alphabet="ab/]-^!\\[c_.", max_size=5)
LIBC = ctypes.CDLL(None)


@given(expression=EXPRESSIONS, text=TEXTS, unescaped=st.sampled_from(["", "_/."]))
def test_the_c_library_reads_what_is_written(expression, text, unescaped):
    try:
        pattern = parse(expression)
    except PatternError:
        assume(False)
    written = exact(pattern, unescaped=unescaped)
    assert parse(written) == pattern
    assert (LIBC.fnmatch(written.encode(), text.encode(), 0) == 0) == matches(pattern, text)


@pytest.mark.parametrize("expression", ["x[b-a]", "[b-a]", "x[b-a]*"])
def test_a_set_without_members_is_written_as_one(expression):
    """This raised IndexError in documents, and was shown as ``[]``, which is ordinary text."""
    assert exact(parse(expression)) == expression


@pytest.mark.parametrize(
    ("expression", "written"),
    [("[_a]", "[\\_a]"), ("[!/]*", "[!\\/]*"), ("a\\*", "a\\*"), ("[[:digit:]]?", "[0-9]?"), ("*?", "?*")],
)
def test_members_of_sets_are_escaped(expression, written):
    assert exact(parse(expression)) == written


def test_harmless_members_may_stay_unescaped():
    assert exact(parse("[_/!]"), unescaped="_/.") == "[\\!/_]"
