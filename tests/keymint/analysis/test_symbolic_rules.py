# SPDX-License-Identifier: Apache-2.0
"""Rewriting patterns with placeholders: over-approximation where wide, else under-approximation."""

from __future__ import annotations

from itertools import product

from hypothesis import given, strategies as st

from comarmor.patterns.glob import Glob, literal, matches, parse, units
from comarmor.patterns.tokens import STAR, Charset, Star
from keymint.analysis.symbolic_rules import NAME, NAMESPACE, concrete_name, fill_placeholders, fit_pattern

NAMESPACES = ("", "a/", "b/", "a/b/")
NAMES = ("a", "b", "ab")
ATOMS = st.sampled_from(["/", "a", "b", "*", "?", "[ab]", NAMESPACE, NAME])
PATTERNS = st.lists(ATOMS, max_size=5).map(lambda atoms: parse("/" + "".join(atoms)))
HALVES = ((STAR,), (STAR,))


def words(shape: Glob) -> list[str]:
    """Return some symbolic words of a shape: what a wildcard matches has no mark."""
    fillings = {Star: ("", "a", "a/b", "b/a"), Charset: ("a", "b", "/")}
    choices = [fillings.get(type(token), (token,)) for token in units(shape)]
    found = ["".join(parts) for parts in product(*choices)]
    return [word for word in found if matches(shape, word)][:60]


@given(PATTERNS, PATTERNS)
def test_narrow_is_too_little_and_wide_too_much(pattern: Glob, shape: Glob) -> None:
    narrow, wide = (fit_pattern(pattern, shape, *HALVES, wide=flag) for flag in (False, True))
    for word, namespace, name in product(words(shape), NAMESPACES, NAMES):
        subject = ((namespace,) if namespace else (), (name,))
        truth = matches(fill_placeholders(pattern, *subject), concrete_name(word, namespace, name))
        little, much = (
            any(
                all(matches(one, namespace) for one in limits)
                and all(matches(one, name) for one in limits2)
                and matches(object_, word)
                for limits, limits2, object_ in found.pieces
            )
            for found in (narrow, wide)
        )
        assert little <= truth <= much
        if narrow.exact:
            assert little is truth
        if wide.exact:
            assert much is truth


@given(PATTERNS)
def test_a_pattern_is_said_as_itself(pattern: Glob) -> None:
    for namespace, name, word in product(NAMESPACES, NAMES, words(pattern)):
        assert any(
            all(matches(one, namespace) for one in limits)
            and all(matches(one, name) for one in limits2)
            and matches(object_, word)
            for limits, limits2, object_ in fit_pattern(pattern, pattern, *HALVES, wide=False).pieces
        )


def test_what_is_exact() -> None:
    same = parse(f"/{NAMESPACE}[ab]")
    assert fit_pattern(same, parse(f"/{NAMESPACE}*"), *HALVES, wide=False).exact
    assert fit_pattern(parse("/a/*"), parse(f"/{NAMESPACE}{NAME}"), *HALVES, wide=False).exact
    assert fit_pattern(parse(f"/x/{NAME}"), parse("/x/a"), *HALVES, wide=False).exact
    assert not fit_pattern(parse(f"/{NAME}"), parse("/*"), *HALVES, wide=False).exact
    assert literal(fill_placeholders(same[:1], ("n/",), ("m",))) == "/n/"
