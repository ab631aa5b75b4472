"""Patterns, found by what they may have in common with another one: by the texts that they begin and end with."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from typing import Generic, TypeVar

from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.relations import disjoint
from comarmor.patterns.steps import spend

_T = TypeVar("_T")
_V = TypeVar("_V")


class PatternIndex(Generic[_T]):
    """An index of patterns, each with what belongs to it.

    Args:
        items: patterns, each with what belongs to it.
    """

    def __init__(self, items: Iterable[tuple[Glob, _T]]) -> None:
        self._exact = _Ends[tuple[Glob, _T]]()
        self._exact_tails = _Ends[tuple[Glob, _T]]()
        self._wild = _Ends[_Ends[tuple[Glob, _T]]]()
        """Patterns with wildcards by their heads, and then by their tails, read backwards."""
        by_head: dict[str, _Ends[tuple[Glob, _T]]] = {}
        for item in items:
            pattern = item[0]
            text = literal(pattern)
            if text is not None:
                self._exact.add(text, item)
                self._exact_tails.add(text[::-1], item)
                continue
            head = _head(pattern)
            if head not in by_head:
                by_head[head] = _Ends()
                self._wild.add(head, by_head[head])
            by_head[head].add(_tail(pattern)[::-1], item)

    def meeting(self, pattern: Glob) -> Iterator[tuple[Glob, _T]]:
        """Yield the patterns that match a name that another pattern matches as well, with what belongs to them."""
        for item in self._candidates(pattern):
            if not disjoint(item[0], pattern):
                yield item

    def _candidates(self, pattern: Glob) -> Iterator[tuple[Glob, _T]]:
        text = literal(pattern)
        if text is not None:
            yield from self._exact.equal(text)
            for bucket in self._wild.before(text):
                yield from bucket.before(text[::-1])
            return
        head, tail = _head(pattern), _tail(pattern)[::-1]
        yield from self._exact.after(head) if head or not tail else self._exact_tails.after(tail)
        for bucket in self._wild.around(head):
            spend()
            yield from bucket.around(tail)


class _Ends(Generic[_V]):
    """Values by the text that they begin with."""

    def __init__(self) -> None:
        self._values: dict[str, list[_V]] = {}
        self._lengths: set[int] = set()
        self._sorted: list[str] | None = None

    def add(self, text: str, value: _V) -> None:
        self._values.setdefault(text, []).append(value)
        self._lengths.add(len(text))
        self._sorted = None

    def equal(self, text: str) -> Iterator[_V]:
        yield from self._values.get(text, ())

    def before(self, text: str) -> Iterator[_V]:
        """Yield the values whose text a text begins with."""
        for length in sorted(self._lengths):
            if length > len(text):
                return
            yield from self._values.get(text[:length], ())

    def after(self, text: str) -> Iterator[_V]:
        """Yield the values whose text begins with a text."""
        if self._sorted is None:
            self._sorted = sorted(self._values)
        for at in range(bisect_left(self._sorted, text), len(self._sorted)):
            if not self._sorted[at].startswith(text):
                return
            yield from self._values[self._sorted[at]]

    def around(self, text: str) -> Iterator[_V]:
        """Yield the values whose text begins with a text, or the other way about."""
        if text:
            yield from self.before(text[:-1])
        yield from self.after(text)


def _head(pattern: Glob) -> str:
    return pattern[0] if pattern and isinstance(pattern[0], str) else ""


def _tail(pattern: Glob) -> str:
    return pattern[-1] if pattern and isinstance(pattern[-1], str) else ""
