# SPDX-License-Identifier: Apache-2.0
"""The key expressions of patterns are proven to match the same names."""

from __future__ import annotations

import random

import pytest
from keymint_ros2_zenoh.keyexpr import TooManyAlternativesError, parse
from keymint_ros2_zenoh.proving import enclave_proof
from keymint_ros2_zenoh.proving.enclave_proof import proven_exact

from comarmor.patterns import glob
from comarmor.patterns.decision_lists import Equal, Unknown, Witness
from tests.effort import tries

PARTS = ("a", "b", "/", "/a", "*", "*", "?", "[ab]", "[!a]", "[a/]", "[0-9]", "1")


def test_random_expressions() -> None:
    generator = random.Random(1)
    proven = 0
    for _ in range(tries(100, 3000)):
        expression = "".join(generator.choices(PARTS, k=generator.randint(1, 5)))
        try:
            assert proven_exact(glob.parse(expression), 50_000) == Equal(), expression
        except TooManyAlternativesError:
            continue
        proven += 1
    assert proven > 50


@pytest.mark.parametrize(
    ("expression", "wrong", "key", "left"),
    [
        ("/a*", ["a$*"], "0/a/a/a/a", True),
        ("/a*b", ["a$*b"], "0/a/b/a/a", True),
        ("/a", ["**/a"], "0/a/a/a/a", False),
        ("/a/*", ["a/**"], "0/a/a/a", False),
        ("/[ab]", ["a"], "0/b/a/a", True),
    ],
)
def test_wrong_key_expressions_are_found(
    monkeypatch: pytest.MonkeyPatch, expression: str, wrong: list[str], key: str, left: bool
) -> None:
    monkeypatch.setattr(enclave_proof, "key_exprs", lambda _pattern: tuple(map(parse, wrong)))
    assert enclave_proof._decided.__wrapped__(glob.parse(expression), 10_000) == Witness(key, left)  # not cached


def test_too_few_states() -> None:
    assert isinstance(proven_exact(glob.parse("*a*b*c*"), 3), Unknown)
