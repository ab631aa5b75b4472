"""Evaluation of many words, held against evaluation by definition."""

from __future__ import annotations

import pytest
from hypothesis import given, settings

from comarmor.patterns import evaluate
from comarmor.patterns.evaluate import Evaluator, permits

from .small import WORDS, lists


@pytest.mark.parametrize("few", [0, evaluate.INDEX_FROM])
@settings(max_examples=200, deadline=None)
@given(lists)
def test_an_evaluator_says_what_the_definition_says(few, decisions):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "INDEX_FROM", few)
        evaluator = Evaluator(decisions)
        said = {word for word in WORDS if evaluator.permits(word)}
        assert said == {word for word in WORDS if permits(decisions, word)}
        assert set(evaluator.permitted_literals()) == {word for word in evaluator.literals if permits(decisions, word)}
