# SPDX-License-Identifier: Apache-2.0
"""The engine agrees with a library that determinises."""

from __future__ import annotations

import functools

from automata.fa.dfa import DFA
from automata.fa.nfa import NFA
from hypothesis import given, settings

from comarmor.patterns.decision_lists import DecisionList, Equal, Witness
from comarmor.patterns.glob import Glob, units
from comarmor.patterns.proofs import difference
from comarmor.patterns.tokens import Charset, Star
from tests.effort import tries

from .small import LETTERS, UNIVERSE, lists


def regex(pattern: Glob) -> str:
    found = ""
    for token in units(pattern):
        if isinstance(token, Star):
            found += "(a|b)*"
        elif isinstance(token, Charset):
            found += f"({'|'.join(letter for letter in LETTERS if letter in token)})"
        else:
            found += token
    return found


@functools.cache
def automaton(pattern: Glob) -> DFA:
    return DFA.from_nfa(NFA.from_regex(regex(pattern), input_symbols=set(LETTERS)))


def permitted(decisions: DecisionList) -> DFA:
    """Return the automaton of what a list permits: for each block the words that no earlier block matches."""
    nothing = DFA.empty_language(set(LETTERS))
    allowed = matched = nothing
    for block in decisions:
        own = functools.reduce(DFA.union, map(automaton, block.patterns), nothing)
        if block.allows:
            allowed = allowed.union(own.difference(matched))
        matched = matched.union(own)
    return allowed


@settings(max_examples=tries(75, 150), deadline=None)
@given(lists, lists)
def test_the_library_finds_the_same(a, b):
    apart = permitted(a).symmetric_difference(permitted(b))
    found = difference(a, b, universe=UNIVERSE)
    assert isinstance(found, Equal) == apart.isempty()
    if isinstance(found, Witness):
        assert len(found.word) == apart.minimum_word_length()
        assert apart.accepts_input(found.word)
