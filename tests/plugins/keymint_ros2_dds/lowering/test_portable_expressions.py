# SPDX-License-Identifier: Apache-2.0
"""Patterns are written so that Cyclone DDS and Fast DDS match the same names."""

from __future__ import annotations

import ctypes
import ctypes.util
import re

import pytest
from hypothesis import assume, given, settings, strategies as st
from keymint_ros2_dds.lowering.portable_expressions import (
    MAX_ALTERNATIVES,
    NotPortableError,
    portable_expressions,
)

from comarmor.patterns import glob
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import matches
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.oracles import matches_any

PIECES = st.sampled_from([*"ab]-^\\!.", "*", "?", "[ab]", "[!a]", "[!ab]", "[]a]", "[!]]", "[!-]", "[!\\\\]", "[a-c]"])
EXPRESSIONS = st.lists(PIECES, min_size=1, max_size=4).map("".join)
TEXTS = st.text(alphabet="ab]-^\\!.c[", max_size=5)
FNM_NOESCAPE = 2


@pytest.fixture(scope="module")
def fnmatch():
    return ctypes.CDLL(ctypes.util.find_library("c")).fnmatch


@settings(deadline=None, max_examples=tries(60, 300))
@given(expression=EXPRESSIONS, text=TEXTS)
def test_all_spellings_together_match_what_the_expression_matches(fnmatch, expression, text):
    assume(not re.search(r"(?<!\\)(\\\\)*\\$", expression))
    tokens = glob.parse(expression)
    try:
        spelled = portable_expressions(tokens)
    except NotPortableError:
        assume(False)
    wanted = matches(tokens, text)
    assert any(fnmatch(one.encode(), text.encode(), FNM_NOESCAPE) == 0 for one in spelled) == wanted
    assert matches_any(spelled, text, cyclone=True) == wanted
    if "\\" not in text:
        assert any(fnmatch(one.encode(), text.encode(), 0) == 0 for one in spelled) == wanted


@pytest.mark.parametrize(
    ("expression", "spelled"),
    [
        ("rt/a*", ("rt/a*",)),
        ("rt/[ab]?", ("rt/a?", "rt/b?")),
        ("[ab][cd]", ("ac", "ad", "bc", "bd")),
        ("[!a]", ("[!a-a]", "]")),
    ],
)
def test_examples(expression, spelled):
    assert portable_expressions(glob.parse(expression)) == spelled


@pytest.mark.parametrize(
    ("expression", "reason"),
    [
        (r"a\*", "literal '\\*'"),
        (r"a\?*", "literal '\\?'"),
        (r"\[a]", "literal '\\['"),
        (r"a\\b", "literal"),
        (r"[a\\]", "literal"),
        (r"[!\\]", "leaves out"),
        (r"[!]]", "leaves out"),
        ("caf\xe9", "not printable ASCII"),
        ("tab\t", "not printable ASCII"),
        (" a", "blank"),
        ("a* ", "blank"),
        ("[!a]-", "followed by '-'"),
        ("[a-z][a-z]", f"more than {MAX_ALTERNATIVES}"),
        ("[ -~]", "']' matches it too"),
    ],
)
def test_what_vendors_would_read_differently_is_refused(expression, reason):
    with pytest.raises(NotPortableError, match=reason):
        portable_expressions(glob.parse(expression))


@given(expression=EXPRESSIONS, text=TEXTS)
def test_the_faithful_spelling_is_an_expression_of_the_standard(fnmatch, expression, text):
    assume(not re.search(r"(?<!\\)(\\\\)*\\$", expression))
    tokens = glob.parse(expression)
    assert (fnmatch(exact(tokens).encode(), text.encode(), 0) == 0) == matches(tokens, text)


@given(st.text(st.sampled_from("ab /~*?[]\\^-\n\x7fé"), min_size=1))
def test_a_name_names_its_first_character_that_vendors_read_differently(text: str) -> None:
    unsafe = re.search(r"[^ -~]|[*?\[\\]", text)
    assume(unsafe or text == text.strip())
    if unsafe is None:
        assert portable_expressions((text,)) == (text,)
    else:
        with pytest.raises(NotPortableError, match=re.escape(f" {unsafe[0]!r}, ")):
            portable_expressions((text,))
