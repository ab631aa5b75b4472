# SPDX-License-Identifier: Apache-2.0
"""Dataclasses that are made quickly are those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError
from typing import Any

import pytest
from hypothesis import given, strategies as st

from comarmor.values import Data, defaults_of, field, replace, values_of


class Standard(type):
    """Makes the same classes by the decorator of the standard library."""

    def __new__(
        cls, name: str, bases: tuple[type, ...], body: dict[str, Any], *, frozen: bool = True, slots: bool = True,
        **options: bool,
    ) -> Any:  # fmt: skip
        if not bases:
            return super().__new__(cls, name, bases, body)
        made = type(name, tuple(base for base in bases if not isinstance(base, cls)), body)
        return dataclasses.dataclass(frozen=frozen, slots=slots, **options)(made)


def classes(base: Any, field: Any) -> dict[str, Any]:
    """Return classes of all kinds that have a base, and whose fields are described by a function."""

    class Frozen(base):
        one: int
        two: str = "x"
        three: list[int] = field(default_factory=list, compare=False)
        four: int = field(default=7, init=False, repr=False)

    class Ordered(base, order=True):
        one: int
        two: str = "x"

    class Below(Frozen, base):
        five: tuple[int, ...] = ()

    class Changing(base, frozen=False):
        one: int
        two: str = "x"

    class Same(base, eq=False):
        one: int
        two: str = "x"

    class Own(base):  # noqa: PLW1641
        one: int
        two: str = "x"

        def __post_init__(self) -> None:
            if self.one < 0:
                raise ValueError("negative")

        def __eq__(self, other: object) -> bool:
            return type(other) is type(self) and self.one == getattr(other, "one", None)

        def __repr__(self) -> str:
            return "own"

    class Open(base, slots=False):
        one: int
        two: str = "x"

    class Single(base):
        one: int

    class Empty(base):
        one: int
        two: str | None = None
        three: str | None = field(default=None, compare=False)

    class Calling(Frozen):
        def __init__(self, one: int) -> None:
            super().__init__(one, "called")

        def __eq__(self, other: object) -> bool:
            return super().__eq__(other)

        __hash__ = Frozen.__hash__

        def __reduce__(self) -> tuple[Any, ...]:
            return type(self), (self.one,)

    return {each.__name__: each for each in (Frozen, Ordered, Below, Changing, Same, Own, Open, Single, Empty, Calling)}


OURS, THEIRS = classes(Data, field), classes(Standard("Base", (), {}), dataclasses.field)
for _name, _class in OURS.items():  # so that they can be pickled
    _class.__qualname__ = _name
    globals()[_name] = _class
    THEIRS[_name].__qualname__ = _name
NUMBERS = st.integers(0, 2)


def outcome(work: Callable[[], object]) -> object:
    try:
        return work()
    except (TypeError, ValueError, FrozenInstanceError, AttributeError) as error:
        return type(error)


@pytest.mark.parametrize("name", OURS)
@given(one=NUMBERS, other=NUMBERS)
def test_they_behave_as_those_of_the_standard_library(name: str, one: int, other: int) -> None:
    seen = []
    for made in (OURS[name], THEIRS[name]):
        a, b = made(one), made(one=other)
        seen.append(
            [
                repr(a), a == b, a != b, a == one,
                name == "Same" or outcome(lambda a=a, b=b: hash(a) == hash(b)),
                outcome(lambda a=a, b=b: (a < b, a <= b, a > b, a >= b)), outcome(lambda a=a: a < 1),
                outcome(lambda a=a: setattr(a, "one", 5)), outcome(lambda a=a: delattr(a, "one")),
                outcome(lambda made=made: made()),
                outcome(lambda made=made: made(-1)) if name == "Own" else 0,
                name == "Calling" or [repr(change(b, one=1)) for change in (dataclasses.replace, replace)],
                outcome(lambda b=b: replace(b, eleven=1)),
                dataclasses.asdict(b),
                [(each.name, each.type, each.init, each.compare) for each in dataclasses.fields(made)],
                outcome(lambda made=made: made(1, one=1)), outcome(lambda made=made: made(1, eleven=1)),
                outcome(lambda made=made: made(*range(11))),
            ]
        )  # fmt: skip
    assert seen[0] == seen[1]


@pytest.mark.parametrize("name", OURS)
def test_their_defaults_are_those_of_their_fields(name: str) -> None:
    fields = dataclasses.fields(THEIRS[name])
    expected = {each.name: each.default for each in fields if each.default is not dataclasses.MISSING}
    assert defaults_of(OURS[name]) == expected
    assert values_of(OURS[name](1)) == dataclasses.asdict(THEIRS[name](1))


@pytest.mark.parametrize("name", OURS)
def test_many_objects_get_a_quicker_way_to_be_made(name: str) -> None:
    """The tests above see the first objects and, as there are many examples, those after them."""
    made = OURS[name]
    assert len({repr(made(1)) for _ in range(60)}) == 1
    assert [*inspect.signature(made).parameters] == [*inspect.signature(THEIRS[name]).parameters]


@pytest.mark.parametrize("name", OURS)
def test_they_can_be_copied_and_sent_to_other_processes(name: str) -> None:
    value = OURS[name](1)
    for copied in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)):
        assert (type(copied), repr(copied), copied.one) == (type(value), repr(value), 1)


def test_no_two_share_a_default() -> None:
    first, second = OURS["Frozen"](1), OURS["Frozen"](1)
    first.three.append(1)
    assert second.three == []


def test_a_field_keeps_what_it_says_about_hashes() -> None:
    class Hashed(Data):
        one: int
        two: str = field(default="x", hash=False)

    assert [each.hash for each in dataclasses.fields(Hashed)] == [None, False]
    assert hash(Hashed(1, "a")) == hash(Hashed(1, "b"))
