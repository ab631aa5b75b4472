# SPDX-License-Identifier: Apache-2.0
"""The trie returns the names within an edit distance."""

from __future__ import annotations

from hypothesis import given, strategies as st

from keymint.analysis.name_similarity import NameTrie

NAMES = st.text(alphabet="ab/", max_size=5)


def distance(one: str, other: str) -> int:
    if not one or not other:
        return len(one) + len(other)
    return min(
        distance(one[1:], other) + 1,
        distance(one, other[1:]) + 1,
        distance(one[1:], other[1:]) + (one[0] != other[0]),
    )


@given(st.sets(NAMES, max_size=8), NAMES, st.integers(1, 2))
def test_names_within_a_distance(names, name, most):
    assert set(NameTrie(names).near(name, most)) == {each for each in names if distance(each, name) <= most}
