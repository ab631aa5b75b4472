# SPDX-License-Identifier: Apache-2.0
"""Key expressions match the names that ``fnmatch`` of the C library matches."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Iterator
from itertools import product
from types import ModuleType

import pytest
from keymint_ros2_zenoh.keyexpr import MAX_ALTERNATIVES, TooManyAlternativesError, includes, key_exprs, parse

from comarmor.patterns import glob
from tests.effort import tries

libc = ctypes.CDLL(None)
PARTS = ("a", "b", "/", "/a", "/", "*", "*", "[ab]", "[a/]", "[!a]", "?", "\\a", "\\*")


def texts(expression: str) -> list[str]:
    return [each.text for each in key_exprs(glob.parse(expression))]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("/a/b", ["a/b"]),
        ("/a*", ["a$*/**"]),
        ("*/a", ["**/a"]),
        ("/*", ["*/**"]),
        ("*", ["*/**"]),
        ("/*/a", ["*/**/a"]),
        ("/a*b", ["a$*/**/$*b", "a$*b"]),
        ("*a*", ["**/$*a$*/**"]),
        ("/robot[1-3]/scan", ["robot1/scan", "robot2/scan", "robot3/scan"]),
        ("/a[*]", []),
        ("/a-b", []),
        ("a", []),
        ("/", []),
        ("*/", []),
        ("//a", []),
        ("/[0-9]", []),
        ("/*" * 12, ["*/" * 12 + "**"]),
    ],
)
def test_expansion(expression: str, expected: list[str]) -> None:
    assert texts(expression) == expected


def test_a_question_mark_stands_for_the_characters_of_ros_names() -> None:
    assert len(texts("/a?b")) == 64
    assert "a/b" in texts("/a?b")


@pytest.mark.parametrize("expression", ["/a??", "/a" + "*a" * 10, "/a" + "*a" * 40, "/a" + "[ab]" * 9])
def test_too_many_alternatives(expression: str) -> None:
    with pytest.raises(TooManyAlternativesError, match=f"more than {MAX_ALTERNATIVES} key expressions"):
        key_exprs(glob.parse(expression))


def names(length: int) -> Iterator[str]:
    """Yield all names of ``a``, ``b`` and ``/`` up to a length."""
    for size in range(1, length):
        for characters in product("ab/", repeat=size):
            name = "/" + "".join(characters)
            if "//" not in name and not name.endswith("/"):
                yield name


def test_the_same_names_as_the_c_library(zenoh: ModuleType) -> None:
    generator = random.Random(1)
    some = list(names(6))
    keys = {name: zenoh.KeyExpr(name[1:]) for name in some}
    matched = 0
    for _ in range(tries(100, 5000)):
        expression = "".join(generator.choices(PARTS, k=generator.randint(1, 5)))
        try:
            own = key_exprs(glob.parse(expression))
        except TooManyAlternativesError:
            continue
        theirs = [zenoh.KeyExpr(each.text) for each in own]
        for name in some:
            expected = libc.fnmatch(expression.encode(), name.encode(), 0) == 0
            matched += expected
            assert any(each.includes(keys[name]) for each in theirs) is expected, (expression, name)
            assert any(includes(each, parse(name[1:])) for each in own) is expected
        for number, each in enumerate(own):
            assert not any(includes(other, each) for other in (*own[:number], *own[number + 1 :]))
    assert matched > 500
