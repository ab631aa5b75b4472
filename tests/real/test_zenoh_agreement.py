# SPDX-License-Identifier: Apache-2.0
"""The model of Zenoh's access control decides as a real router does, on random configurations and messages."""

from __future__ import annotations

import pytest

from tests.effort import tries

from .zenoh_agreement import disagreements

pytestmark = pytest.mark.zenoh


def test_the_model_agrees_on_random_configurations(zenoh_library: str) -> None:
    compared = list(disagreements(tries(5, 60), keys=10, seed=1))
    assert [text for _, text in compared if text] == []
    assert len(compared) > tries(1_000, 30_000)
    assert {allowed for allowed, _ in compared} == {False, True}


def test_a_wrong_model_would_be_seen(zenoh_library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison itself: with an inclusion that ignores ``@``, the model and the router differ."""
    from keymint_ros2_zenoh import decision

    right = decision.includes

    def wrong(outer, inner):
        from keymint_ros2_zenoh.keyexpr import parse

        return right(outer, inner) or right(outer, parse(inner.text.replace("@", "")))

    monkeypatch.setattr(decision, "includes", wrong)
    assert any(text for _, text in disagreements(5, 10, seed=7))
