# SPDX-License-Identifier: Apache-2.0
"""Derivatives accept what their patterns match, and the inclusion test is sound."""

from __future__ import annotations

from hypothesis import given, settings

from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.glob import parse
from comarmor.patterns.matching import matches
from tests.effort import tries

from .small import UNIVERSE, WORDS, globs


@settings(max_examples=tries(60, 300), deadline=None)
@given(globs)
def test_a_word_is_accepted_if_its_derivative_accepts(pattern):
    derivatives = Derivatives((pattern,), UNIVERSE)
    for word in WORDS[:63]:
        nodes = frozenset((derivatives.node(pattern),))
        for letter in word:
            nodes = derivatives.steps(nodes, letter)
        assert any(derivatives.accepts[node] for node in nodes) == matches(pattern, word)


@settings(max_examples=tries(100, 600), deadline=None)
@given(globs, globs)
def test_inclusion_is_sound(outer, inner):
    derivatives = Derivatives((outer, inner), UNIVERSE)
    if derivatives.includes(derivatives.node(outer), derivatives.node(inner)):
        assert all(matches(outer, word) for word in WORDS if matches(inner, word))


def test_inclusion_is_found_between_ordinary_patterns():
    for wide, narrow in (("rt/*", "rt/x*"), ("*a", "*ba"), ("*", "a?"), ("a*b", "a?b")):
        derivatives = Derivatives((parse(wide), parse(narrow)), UNIVERSE)
        assert derivatives.includes(derivatives.node(parse(wide)), derivatives.node(parse(narrow)))
        assert not derivatives.includes(derivatives.node(parse(narrow)), derivatives.node(parse(wide)))
