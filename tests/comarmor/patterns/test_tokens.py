# SPDX-License-Identifier: Apache-2.0
"""Expressions are split into tokens as the dialect says; see also the tests of each dialect in use."""

from __future__ import annotations

import pytest

from comarmor.patterns.glob import matches, parse
from comarmor.patterns.tokens import ANY, COMARMOR, NOTHING, POSIX, STAR, Bracket, Dialect, PatternError, tokenize

PLAIN = Dialect()
NO_ESCAPES = Dialect(escapes=False)
CYCLONE = Dialect(escapes=False, negators=("!",), classes=False, closing_bracket_is_member=True)


@pytest.mark.parametrize(
    ("expression", "dialect", "tokens"),
    [
        ("a*?", PLAIN, ["a", STAR, ANY]),
        ("\\*", PLAIN, ["*"]),
        ("\\*", NO_ESCAPES, ["\\", STAR]),
        ("a\\", PLAIN, ["a", NOTHING]),
        ("a\\", NO_ESCAPES, ["a", "\\"]),
        ("[^a]", PLAIN, [Bracket(True, (("a", "a"),))]),
        ("[^a]", CYCLONE, [Bracket(False, (("^", "^"), ("a", "a"), ("]", "]")))]),
        ("[[:digit:]a-c]", PLAIN, [Bracket(False, ("digit", ("a", "c")))]),
        ("[a", PLAIN, ["[", "a"]),
        ("x[a", CYCLONE, ["x", NOTHING]),
        ("[a]-c]", CYCLONE, [Bracket(False, (("a", "a"), ("]", "c"))), "]"]),
        ("[!]x", CYCLONE, [ANY, "]", "x"]),
        ("[]-a]", PLAIN, [Bracket(False, (("]", "a"),))]),
        ("[a\\-c]", PLAIN, [Bracket(False, (("a", "a"), ("-", "-"), ("c", "c")))]),
    ],
)
def test_tokens(expression, dialect, tokens):
    assert list(tokenize(expression, dialect)) == tokens


@pytest.mark.parametrize("expression", ["a\\", "[[:nope:]]", "[[=a=]]", "[[.a.]]", "[z-a]", "[a-[:digit:]]"])
def test_undefined_notation_is_an_error_in_policies_only(expression):
    with pytest.raises(PatternError) as error:
        parse(expression, COMARMOR)
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "expression"
    assert diagnostic.help
    assert not matches(parse(expression, PLAIN), "b")


@pytest.mark.parametrize("expression", ["[z-a", "a[[:alpha:]", "[a"])
def test_an_unclosed_bracket_is_ordinary_text(expression):
    assert matches(parse(expression, COMARMOR), expression) == (expression != "a[[:alpha:]")
    assert parse(expression, COMARMOR) == parse(expression, POSIX)


def test_complements_and_intersections_of_sets():
    digits = parse("[0-9]")[0]
    assert digits.complement().complement() == digits
    assert "".join(digits.intersection(parse("[!0-6]")[0]).chars()) == "789"
    assert len(digits) == 10
