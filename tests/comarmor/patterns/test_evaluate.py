# SPDX-License-Identifier: Apache-2.0
"""The fast evaluator decides as the definition does."""

from __future__ import annotations

import pytest
from hypothesis import given, settings

from comarmor.patterns import evaluate
from comarmor.patterns.evaluate import Evaluator, permits
from tests.effort import tries

from .small import WORDS, lists


@pytest.mark.parametrize("few", [0, evaluate.INDEX_FROM])
@settings(max_examples=tries(60, 200), deadline=None)
@given(lists)
def test_an_evaluator_decides_as_the_definition_does(few, decisions):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "INDEX_FROM", few)
        evaluator = Evaluator(decisions)
        permitted = {word for word in WORDS if evaluator.permits(word)}
        assert permitted == {word for word in WORDS if permits(decisions, word)}
        assert set(evaluator.permitted_literals()) == {word for word in evaluator.literals if permits(decisions, word)}
