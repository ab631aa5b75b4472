# SPDX-License-Identifier: Apache-2.0
"""Dataclasses that are made in a quarter of the time: a short run spends most of its time on imports, with 150 of them.

:func:`dataclasses.dataclass` generates and compiles each method of each class. Here only ``__init__`` is generated,
for a class with many objects; the other methods are functions over the values of the fields.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from types import MemberDescriptorType
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(cls: type | None = None, /, **options: bool) -> Any:
        """Return a class as a dataclass; the options of :func:`_made` are those of :func:`dataclasses.dataclass`."""
        make = partial(_made, **options)
        return make if cls is None else make(cls)


__all__ = ["dataclass"]
_FEW = 50
"""Objects of a class that are made before its ``__init__`` is generated."""


def _made(given: type, *, frozen: bool = False, slots: bool = False, eq: bool = True, order: bool = False) -> Any:
    if not given.__doc__:  # or the library inspects the signature to make one
        given.__doc__ = given.__name__
    annotations = given.__annotations__
    # The library searches a text for names of its own, with regular expressions; only this one is used.
    given.__annotations__ = {name: each if "ClassVar" in str(each) else None for name, each in annotations.items()}
    cls: Any = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots)(given)
    cls.__annotations__ = annotations
    fields = dataclasses.fields(cls)
    for field in fields:
        field.type = annotations.get(field.name, field.type)
    own = vars(given)
    new: dict[str, Any] = {"__init__": _first_init(cls, fields, frozen=frozen), "__repr__": _repr}
    if eq:
        new |= _comparison(_values([field.name for field in fields if field.compare]), order=order)
        new["__hash__"] = None
    if frozen:
        new |= {"__setattr__": _refuse, "__delattr__": _refuse, "__getstate__": _state, "__setstate__": _set_state}
        if eq:
            values = _values([field.name for field in fields if (field.compare if field.hash is None else field.hash)])
            new["__hash__"] = lambda self: hash(values(self))
    for name, method in new.items():
        if own.get(name) is None:  # a class that defines __eq__ has a __hash__ of None
            setattr(cls, name, method)
    return cls


def _first_init(cls: Any, fields: tuple[dataclasses.Field[Any], ...], *, frozen: bool) -> Callable[..., None]:
    """Return a method that sets the fields of the first objects one by one, and then generates a quicker one.

    A run makes few objects of most classes, and generating a method costs as much as fifty of them.
    """
    parameters = [field.name for field in fields if field.init]
    left = _FEW

    def __init__(self: Any, /, *arguments: Any, **named: Any) -> None:  # noqa: N807
        nonlocal left
        left -= 1
        given = dict(zip(parameters, arguments, strict=False)) | named
        values = defaults | {name: new() for name, new in factories.items() if name not in given} | given
        is_sound = len(given) == len(arguments) + len(named) and given.keys() <= known <= values.keys()
        if left < 0 or not is_sound:  # the generated method says what is wrong
            cls.__init__ = _init(cls, fields, frozen=frozen)
            cls.__init__(self, *arguments, **named)
            return
        for name, value in values.items():
            assign(self, name, value)
        if has_post_init:
            self.__post_init__()

    absent = dataclasses.MISSING
    known = frozenset(parameters)
    defaults = {field.name: field.default for field in fields if field.default is not absent}
    factories = {field.name: field.default_factory for field in fields if field.default_factory is not absent}
    assign, has_post_init = object.__setattr__, hasattr(cls, "__post_init__")
    return __init__


def _init(cls: Any, fields: tuple[dataclasses.Field[Any], ...], *, frozen: bool) -> Callable[..., None]:
    """Return the method that sets the fields."""
    known: dict[str, Any] = {"_set": object.__setattr__, "_missing": dataclasses.MISSING}
    parameters, body = ["self"], []
    for field in fields:
        name, value = field.name, field.name
        if field.default_factory is not dataclasses.MISSING:
            known[f"_new_{name}"] = field.default_factory
            value = f"_new_{name}() if {name} is _missing else {name}" if field.init else f"_new_{name}()"
            default = "=_missing"
        elif field.default is not dataclasses.MISSING:
            known[f"_default_{name}"] = field.default
            default = f"=_default_{name}"
        else:
            default = ""
        if field.init:
            parameters.append(f"{name}{default}")
        elif not default:
            continue
        elif value == name:
            value = f"_default_{name}"
        if isinstance(slot := getattr(cls, name, None), MemberDescriptorType):  # quicker than object.__setattr__
            known[f"_set_{name}"] = slot.__set__
            body.append(f"_set_{name}(self, {value})")
        else:
            body.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
    if hasattr(cls, "__post_init__"):
        body.append("self.__post_init__()")
    method = f" def __init__({', '.join(parameters)}):\n  " + "\n  ".join(body or ["pass"])
    text = f"def make({', '.join(known)}):\n{method}\n return __init__"
    made: dict[str, Any] = {}
    exec(text, vars(sys.modules[cls.__module__]), made)  # noqa: S102 - has names of fields only
    init: Callable[..., None] = made["make"](**known)
    init.__qualname__ = f"{cls.__qualname__}.__init__"
    init.__annotations__ = {field.name: field.type for field in fields if field.init}
    return init


def _values(names: list[str]) -> Callable[[Any], Any]:
    """Return a function that returns the values of fields, as a tuple if there are several."""
    return attrgetter(*names) if names else lambda _self: ()


def _comparison(values: Callable[[Any], Any], *, order: bool) -> dict[str, Any]:
    """Return the methods that compare values of one class."""

    def equal(self: object, other: object) -> bool:
        return values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented

    def less(self: object, other: object) -> bool:
        return values(self) < values(other) if other.__class__ is self.__class__ else NotImplemented

    def less_or_equal(self: object, other: object) -> bool:
        return values(self) <= values(other) if other.__class__ is self.__class__ else NotImplemented

    # Python asks the other operand for > and >=.
    return {"__eq__": equal} | ({"__lt__": less, "__le__": less_or_equal} if order else {})


def _repr(self: Any) -> str:
    shown = ", ".join(f"{each.name}={getattr(self, each.name)!r}" for each in dataclasses.fields(self) if each.repr)
    return f"{self.__class__.__qualname__}({shown})"


def _refuse(self: object, name: str, _value: object = None) -> NoReturn:
    del self
    raise dataclasses.FrozenInstanceError(f"cannot change field {name!r}")


def _state(self: Any) -> list[Any]:
    return [getattr(self, field.name) for field in dataclasses.fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:
    for field, value in zip(dataclasses.fields(self), state, strict=True):
        object.__setattr__(self, field.name, value)
