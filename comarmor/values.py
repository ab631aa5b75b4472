# SPDX-License-Identifier: Apache-2.0
"""The base of the data types, which are dataclasses: a short run spends most of its time on imports, with 200 of them.

:func:`dataclasses.dataclass` makes a class with slots a second time, and generates and compiles each method of it; a
run makes no object of most of them. Here a class is made once and gets what it needs at the first use. Only
``__init__`` is generated, for a class with many objects; the other methods are functions over the values of the fields.
The library itself, which takes as long to load as ten of our modules, loads when its part of a class is asked for.
"""

from __future__ import annotations

import operator
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from types import MemberDescriptorType, SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn, dataclass_transform

if TYPE_CHECKING:
    from dataclasses import Field, field, replace

__all__ = ["Data", "defaults_of", "field", "replace", "values_of"]
_MISSING = object()
_FEW = 50
"""Objects of a class that are made before its ``__init__`` is generated."""
_DECLARED = "__declared__"
"""Attribute of a class with all its fields: the type of each, and its default or :func:`field`."""


class _Described(SimpleNamespace):
    """What a class says of a field beside its type, as :func:`dataclasses.field` takes it."""

    default: Any = _MISSING
    default_factory: Any = _MISSING
    init = repr = compare = True
    hash: bool | None = None


if not TYPE_CHECKING:
    field = _Described

    def replace(given: Any, /, **changes: Any) -> Any:
        """Return an object with other values of some fields, as :func:`dataclasses.replace`, which asks more first."""
        cls = type(given)
        if _DECLARED not in vars(cls):
            return _library().replace(given, **changes)
        values = [changes.pop(name) if name in changes else getattr(given, name) for name in _given(cls)[0]]
        return cls(*values, **changes)


class _DataType(type):
    """Makes the classes that name :class:`Data` as a base, without that base: they are of no special type."""

    def __new__(
        cls,
        name: str,
        bases: tuple[type, ...],
        body: dict[str, Any],
        *,
        frozen: bool = True,
        slots: bool = True,
        eq: bool = True,
        order: bool = False,
    ) -> Any:
        if not bases:
            return super().__new__(cls, name, bases, body)
        # Loops, since a comprehension takes longer than what most of these classes have to loop over.
        types = body.get("__annotations__", {})
        declared: dict[str, tuple[Any, Any]] = {}
        own: list[str] = []
        inherited: set[str] = set()
        kept: list[type] = []
        for base in bases:
            if base is not Data:
                kept.append(base)
                declared = _declared(base) | declared
                inherited.update(*[vars(each).get("__slots__", ()) for each in base.__mro__])
        for each in types:
            if "ClassVar" not in str(types[each]):
                declared[each] = types[each], body.pop(each, _MISSING)
                if each not in inherited:
                    own.append(each)
        new = {**_methods(frozen, eq, order), **body, _DECLARED: declared}
        if slots:
            new["__slots__"] = tuple(own)
        return type(name, tuple(kept), new)


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Data(metaclass=_DataType):
    """Base of the data types: a subclass is a frozen dataclass with slots.

    The options of the class statement are those of :func:`dataclasses.dataclass`: ``frozen``, ``slots``, ``eq`` and
    ``order``. As with :class:`typing.NamedTuple`, a subclass is not an instance of a special type, nor its subclasses:
    each names this base itself.
    """


def defaults_of(cls: type) -> Mapping[str, Any]:
    """Return the defaults of the fields of a data type by name, except those that are made for each object."""
    return _given(cls)[1]


def values_of(given: Any) -> dict[str, Any]:
    """Return the values of an object of a data type by the names of its fields."""
    return {name: getattr(given, name) for name in _declared(type(given))}


def _library() -> Any:
    import dataclasses  # noqa: PLC0415 - most runs do without it

    return dataclasses


@cache
def _methods(frozen: bool, eq: bool, order: bool) -> dict[str, Any]:
    chosen = ((_ANY, True), (_EQUAL, eq), ({"__hash__": None}, eq and not frozen), (_ORDERED, order), (_FROZEN, frozen))
    return {name: each for some, is_chosen in chosen if is_chosen for name, each in some.items()}


class _AtFirstUse:
    """An attribute of a class that is made when it is first asked for.

    Args:
        name: its name.
        make: makes it for a class.
    """

    def __init__(self, name: str, make: Callable[[Any], Any]) -> None:
        self._name = name
        self._make = make

    def __get__(self, given: object, owner: type) -> Any:
        for cls in owner.__mro__:
            if vars(cls).get(self._name) is self:
                made = self._make(cls)
                setattr(cls, self._name, made)
                return made.__get__(given, owner) if callable(made) else made
        return getattr(owner if given is None else given, self._name)  # another thread has made it


def _declared(cls: type) -> dict[str, tuple[Any, Any]]:
    """Return what a class and its bases declare of each field, those of its bases first: its type and its default."""
    declared: dict[str, tuple[Any, Any]] = getattr(cls, _DECLARED, {})
    return declared


def _fields(cls: type) -> dict[str, _Described]:
    """Return what is said of the fields of a class by name, those of its bases first."""
    declared = _declared(cls).items()
    return {name: each if isinstance(each, _Described) else _Described(default=each) for name, (_, each) in declared}


def _known_fields(cls: type) -> dict[str, Field[Any]]:
    """Return the fields as the library knows them: by name, with their types, and with all that it notes about any."""
    fields: dict[str, Field[Any]] = {}
    for name, described in _fields(cls).items():
        said = {word: value for word, value in vars(described).items() if value is not _MISSING}
        fields[name] = each = _library().field(**said)
        for slot, value in _noted():
            setattr(each, slot, value)
        each.name, each.type, each.kw_only = name, _declared(cls)[name][0], False
    return fields


@cache
def _noted() -> list[tuple[str, Any]]:
    """Return what the library notes about the field of a class that nothing says, by slot."""
    # Without a text about the class the library makes one, which takes long.
    made = type("Made", (), {"__doc__": "made", "__annotations__": {"field": "int"}})
    library = _library()
    full, bare = library.fields(library.dataclass(init=False, repr=False, eq=False)(made))[0], library.field()
    # What is None in both, such as a hash, a field may say.
    return [(slot, value) for slot in bare.__slots__ if getattr(bare, slot) is None and (value := getattr(full, slot))]


@cache
def _given(cls: type) -> tuple[list[str], dict[str, Any], dict[str, Callable[[], Any]]]:
    """Return the parameters of a class, the defaults of its fields, and what makes those that are made each time."""
    parameters: list[str] = []
    defaults: dict[str, Any] = {}
    factories: dict[str, Callable[[], Any]] = {}
    for name, (_, each) in _declared(cls).items():
        is_described = type(each) is _Described
        if not is_described or each.init:
            parameters.append(name)
        if is_described and each.default_factory is not _MISSING:
            factories[name] = each.default_factory
        elif (default := each.default if is_described else each) is not _MISSING:
            defaults[name] = default
    return parameters, defaults, factories


def _first_init(cls: Any) -> Callable[..., None]:
    """Return a method that sets the fields of the first objects one by one, and then generates a quicker one.

    A run makes few objects of most classes, and generating a method costs as much as fifty of them.
    """
    parameters, defaults, factories = _given(cls)
    known, every_field = frozenset(parameters), len({*parameters, *defaults, *factories})
    least, last = len(parameters) - len(defaults), tuple(defaults.values())
    is_simple = not factories and parameters[least:] == list(defaults)
    assign, has_post_init, left = object.__setattr__, hasattr(cls, "__post_init__"), _FEW

    def __init__(self: Any, /, *arguments: Any, **named: Any) -> None:  # noqa: N807
        nonlocal left
        left -= 1
        values: Iterable[tuple[str, Any]]
        if is_sound := is_simple and not named and least <= len(arguments) <= len(parameters):  # most calls
            values = zip(parameters, arguments + last[len(arguments) - least :])  # noqa: B905 - slower, and as many
        else:
            given = dict(zip(parameters, arguments, strict=False), **named) if arguments else named
            every = defaults | given
            for name, new in factories.items():
                if name not in given:
                    every[name] = new()
            is_sound = len(given) == len(arguments) + len(named) and given.keys() <= known and len(every) == every_field
            values = every.items()
        if left < 0 or not is_sound:  # the generated method says what is wrong
            cls.__init__ = _init(cls)
            cls.__init__(self, *arguments, **named)
            return
        for name, value in values:
            assign(self, name, value)
        if has_post_init:
            self.__post_init__()

    return __init__


def _init(cls: Any) -> Callable[..., None]:
    """Return the method that sets the fields."""
    fields = _fields(cls)
    known: dict[str, Any] = {"_set": object.__setattr__, "_missing": _MISSING}
    parameters, body = ["self"], []
    for name, each in fields.items():
        value = name
        if each.default_factory is not _MISSING:
            known[f"_new_{name}"] = each.default_factory
            value = f"_new_{name}() if {name} is _missing else {name}" if each.init else f"_new_{name}()"
            default = "=_missing"
        elif each.default is not _MISSING:
            known[f"_default_{name}"] = each.default
            default = f"=_default_{name}"
        else:
            default = ""
        if each.init:
            parameters.append(f"{name}{default}")
        elif not default:
            continue
        elif value == name:
            value = f"_default_{name}"
        if isinstance(slot := getattr(cls, name, None), MemberDescriptorType):  # quicker than object.__setattr__
            known[f"_set_{name}"] = slot.__set__
            body.append(f"_set_{name}(self, {value})")
        else:
            body.append(f"_set(self, {name!r}, {value})")
    if hasattr(cls, "__post_init__"):
        body.append("self.__post_init__()")
    method = f" def __init__({', '.join(parameters)}):\n  " + "\n  ".join(body or ["pass"])
    text = f"def make({', '.join(known)}):\n{method}\n return __init__"
    made: dict[str, Any] = {}
    exec(text, vars(sys.modules[cls.__module__]), made)  # noqa: S102 - has names of fields only
    init: Callable[..., None] = made["make"](**known)
    init.__qualname__ = f"{cls.__qualname__}.__init__"
    return init


def _compared(cls: type, counts: Callable[[_Described], bool] = operator.attrgetter("compare")) -> Callable[[Any], Any]:
    """Return a function that returns the values of the fields that count, as a tuple if there are several."""
    names = [name for name, (_, each) in _declared(cls).items() if not isinstance(each, _Described) or counts(each)]
    return operator.attrgetter(*names) if names else lambda _self: ()


def _comparing(compare: Callable[[Any, Any], Any], cls: type) -> Callable[[Any, object], Any]:
    """Return the method of a class that compares the values of two objects."""
    values = _compared(cls)
    return lambda self, other: compare(values(self), values(other)) if type(other) is type(self) else NotImplemented


def _hash(cls: type) -> Callable[[Any], int]:
    values = _compared(cls, lambda each: each.compare if each.hash is None else each.hash)
    return lambda self: hash(values(self))


def _repr(self: Any) -> str:
    shown = ", ".join(f"{name}={getattr(self, name)!r}" for name, each in _fields(type(self)).items() if each.repr)
    return f"{self.__class__.__qualname__}({shown})"


def _refuse(self: object, name: str, _value: object = None) -> NoReturn:
    del self
    raise _library().FrozenInstanceError(f"cannot change field {name!r}")


def _reduce(cls: type) -> Callable[[Any], Any]:
    """Return the method that pickles by the arguments of the constructor, which is faster than field by field."""
    names = _given(cls)[0]
    if len(names) > 1:
        values = operator.attrgetter(*names)
        return lambda self: (type(self), values(self))
    return lambda self: (type(self), tuple([getattr(self, name) for name in names]))


def _made_later(**makers: Callable[[Any], Any]) -> dict[str, Any]:
    return {f"__{name}__": _AtFirstUse(f"__{name}__", make) for name, make in makers.items()}


_ANY = {"__repr__": _repr} | _made_later(init=_first_init, dataclass_fields=_known_fields)
_EQUAL = _made_later(eq=partial(_comparing, operator.eq), hash=_hash)
# Python asks the other operand for > and >=.
_ORDERED = _made_later(lt=partial(_comparing, operator.lt), le=partial(_comparing, operator.le))
_FROZEN = {"__setattr__": _refuse, "__delattr__": _refuse} | _made_later(reduce=_reduce)
"""What a class gets, by the options of its decorator."""
