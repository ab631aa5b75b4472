"""Which deviation makes an implementation decide otherwise than the standard."""

from __future__ import annotations

from collections.abc import Callable

from keymint_ros2_dds.decision.semantics import OMG, Deviation, Variation

Ask = Callable[[Variation], bool]
"""Asks the same question of an implementation."""


def explain(ask: Ask, variation: Variation) -> tuple[Deviation, ...]:
    """Return the deviations that make the difference; none if there is no difference.

    Those each of which suffices alone tell best; where none does, those without any of which the implementation would
    decide as the standard does; else all that there are.
    """
    expected, found = ask(OMG), ask(variation)
    if expected == found:
        return ()
    alone = tuple(each for each in variation.deviations if ask(variation.only(each)) == found)
    if alone:
        return alone
    needed = tuple(each for each in variation.deviations if ask(variation.without(each)) == expected)
    return needed or variation.deviations
