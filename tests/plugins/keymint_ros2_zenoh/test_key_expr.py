# SPDX-License-Identifier: Apache-2.0
"""Key expressions and their canonical form, judged by the real library."""

from __future__ import annotations

import random
from types import ModuleType

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_zenoh.keyexpr import KeyExprError, canonical, parse

from tests.effort import tries

PARTS = ("a", "b", "/", "/", "a", "@", "*", "**", "$*", "$", "#", "é")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a/b", "a/b"),
        ("**/**", "**"),
        ("**/*", "*/**"),
        ("*/**/*/**/a", "*/*/**/a"),
        ("$*", "*"),
        ("a/$*/b", "a/*/b"),
        ("a$*$*$*b", "a$*b"),
        ("**/$*", "*/**"),
        ("@$*/**", "@$*/**"),
    ],
)
def test_canonical_form(text: str, expected: str) -> None:
    assert canonical(text).text == expected
    assert canonical(text).chunks == tuple(expected.split("/"))


@pytest.mark.parametrize("text", ["", "/", "/a", "a/", "a//b", "a*", "*a", "***", "a$b", "$", "a#", "a?b", "$**", "@*"])
def test_what_is_no_key_expression(text: str) -> None:
    with pytest.raises(KeyExprError):
        canonical(text)


def test_parse_wants_the_canonical_form() -> None:
    with pytest.raises(KeyExprError, match=r"'\*\*/\*' is not in canonical form, which is '\*/\*\*'"):
        parse("**/*")


def test_literal() -> None:
    assert parse("a/@b").is_literal
    assert not parse("a/b$*").is_literal


@given(st.lists(st.sampled_from(PARTS), max_size=9).map("".join))
def test_the_canonical_form_is_canonical(text: str) -> None:
    try:
        once = canonical(text)
    except KeyExprError:
        return
    assert parse(once.text) == once


def test_the_library_accepts_exactly_the_canonical_ones(zenoh: ModuleType) -> None:
    generator = random.Random(1)
    accepted = 0
    for _ in range(tries(20_000, 300_000)):
        text = "".join(generator.choices(PARTS, k=generator.randint(0, 8)))
        try:
            zenoh.KeyExpr(text)
        except zenoh.ZError:
            with pytest.raises(KeyExprError):
                parse(text)
        else:
            accepted += 1
            assert parse(text).text == text
    assert accepted > 1000
