"""Evaluation of many words, held against evaluation by definition."""

from __future__ import annotations

import pytest
from hypothesis import given, settings

from keymint.proof import permits, plain
from keymint.proof.plain import Evaluator

from .small import WORDS, lists


@pytest.mark.parametrize("few", [0, plain.FEW])
@settings(max_examples=200, deadline=None)
@given(lists)
def test_an_evaluator_says_what_the_definition_says(few, decisions):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain, "FEW", few)
        evaluator = Evaluator(decisions)
        said = {word for word in WORDS if evaluator.permits(word)}
        assert said == {word for word in WORDS if permits(decisions, word)}
        assert set(evaluator.permitted()) == {word for word in evaluator.named if permits(decisions, word)}
