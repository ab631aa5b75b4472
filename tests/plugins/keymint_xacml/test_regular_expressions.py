# SPDX-License-Identifier: Apache-2.0
"""Regular expressions match the names that expressions match."""

from __future__ import annotations

import re

import pytest
from keymint_xacml.policy_set import TextMatch, text_match

from comarmor.patterns.expression import matches
from keymint.errors import UnsayableError

_CHARS = ("", *"abcxyz019_/.-^$|?*+()[]{}\\ \n\t\r~é\U0001f916")


@pytest.mark.parametrize(
    ("expression", "regular"),
    [
        ("/a*", r"^/a[\s\S]*$"),
        ("?", r"^[\s\S]$"),
        ("[a-cx]", "^[a-cx]$"),
        ("[!a]*", r"^[^a][\s\S]*$"),
        ("[]^-]", r"^[\-\]-\^]$"),
        (r"a.\*?", r"^a\.\*[\s\S]$"),
        ("[[:space:]]", r"^[\t-\n\r ]$"),
        ("{a}$|+*", r"^\{a\}\$\|\+[\s\S]*$"),
    ],
)
def test_expressions(expression: str, regular: str) -> None:
    assert text_match(expression) == TextMatch(regular, is_regular=True)


@pytest.mark.parametrize(("expression", "text"), [("/a.b", "/a.b"), (r"/\*", "/*"), ("[a]", "a"), ("", "")])
def test_a_name_is_compared_as_it_is(expression: str, text: str) -> None:
    assert text_match(expression, "/x") == TextMatch(f"{text}/x", is_regular=False)


@pytest.mark.parametrize(
    "expression",
    ["[!a-z]", "[[:alnum:]_]", "[^[:cntrl:]]", "[!-/]", "[a\\]b]", "[\\^a]", "x[$|]", "[]a]", "[[]", "*?", "[--/]"],
)
def test_all_short_names(expression: str) -> None:
    found = text_match(expression, ".s")
    search = re.compile(
        found.text.removesuffix("$") + r"\Z" if found.is_regular else re.escape(found.text) + r"\Z"
    ).match
    for first in _CHARS:
        for second in _CHARS:
            name = first + second
            assert bool(search(name + ".s")) is matches(expression, name), (expression, name)
            assert not search(name + "_s")


@pytest.mark.parametrize(
    ("expression", "why"), [("[\x01]*", "U+0001"), ("[\x01\x02]", "none of"), ("a\x7f\x00", "U+0000")]
)
def test_what_xml_cannot_contain(expression: str, why: str) -> None:
    with pytest.raises(UnsayableError, match=re.escape(why)):
        text_match(expression)
