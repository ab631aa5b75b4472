# SPDX-License-Identifier: Apache-2.0
"""Inclusion and intersection, judged by the real library and by what they mean for literal keys."""

from __future__ import annotations

import random
import re
from collections import Counter
from types import ModuleType

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_zenoh.keyexpr import KeyExpr, canonical, includes, intersects, parse

from tests.effort import tries

CHUNKS = (
    "a", "b", "ab", "ba", "aa", "@", "@a", "*", "*", "**", "**", "$*a", "a$*", "a$*b", "$*a$*", "a$*a", "$*ab$*a",
    "b$*a$*b", "@a$*", "$*@a", "@$*",
)  # fmt: skip

expressions = st.lists(st.sampled_from(CHUNKS), min_size=1, max_size=5).map("/".join).map(canonical)
keys = st.lists(st.sampled_from(("a", "b", "ab", "ba", "aab", "@", "@a", "a@a")), min_size=1, max_size=5)
keys_of_text = keys.map("/".join).map(parse)


def matches(expression: KeyExpr, key: KeyExpr) -> bool:
    """Match by a regular expression, written down without the code under test."""
    pattern = ""
    for chunk in expression.chunks:
        if chunk == "**":
            pattern += r"(?:[^/@][^/]*/)*"
        elif chunk == "*":
            pattern += r"[^/@][^/]*/"
        else:
            plain = re.escape(chunk).replace(r"\$\*", "[^/]*")
            pattern += (r"(?!@)" if not chunk.startswith("@") else "") + plain + "/"
    return re.fullmatch(pattern, key.text + "/") is not None


@given(expressions, keys_of_text)
def test_for_literal_keys_both_tell_whether_an_expression_matches(expression: KeyExpr, key: KeyExpr) -> None:
    if any(chunk.startswith("@") and "$*" in chunk for chunk in expression.chunks):
        return  # Zenoh compares verbatim chunks as they are
    assert includes(expression, key) is intersects(expression, key) is matches(expression, key)


@given(expressions, expressions, keys_of_text)
def test_what_is_included_matches_less(outer: KeyExpr, inner: KeyExpr, key: KeyExpr) -> None:
    if includes(outer, inner):
        assert intersects(outer, inner)
        assert includes(outer, key) or not includes(inner, key)


@given(expressions, expressions)
def test_laws(left: KeyExpr, right: KeyExpr) -> None:
    assert includes(left, left)
    assert intersects(left, right) is intersects(right, left)


@pytest.mark.parametrize(
    ("outer", "inner", "included"),
    [
        ("0/secret/**", "0/secret/x", True),
        ("0/secret/**", "0/*/x", False),
        ("**", "a/@adv", False),
        ("a/*/*/@adv/**", "a/t/h/@adv/pub/z/e/_", True),
        ("*/**/a", "**/b/a", False),  # by their languages it is included; Zenoh does not see it
    ],
)
def test_inclusion_in_access_control(outer: str, inner: str, included: bool) -> None:
    assert includes(parse(outer), parse(inner)) is included


def test_the_library_agrees(zenoh: ModuleType) -> None:
    generator = random.Random(1)
    outcomes: Counter[tuple[bool, bool]] = Counter()
    for _ in range(tries(20_000, 200_000)):
        left, right = (canonical("/".join(generator.choices(CHUNKS, k=generator.randint(1, 5)))) for _ in "12")
        theirs, theirs2 = zenoh.KeyExpr(left.text), zenoh.KeyExpr(right.text)
        outcome = includes(left, right), intersects(left, right)
        assert outcome == (theirs.includes(theirs2), theirs.intersects(theirs2)), (left, right)
        outcomes[outcome] += 1
    assert min(outcomes[True, True], outcomes[False, True], outcomes[False, False]) > 300
