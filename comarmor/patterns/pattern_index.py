# SPDX-License-Identifier: Apache-2.0
"""Index patterns by the texts that they begin and end with."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import chain
from typing import Generic, TypeVar

from comarmor.patterns.glob import Glob, Matcher, literal, matcher, prefix, suffix
from comarmor.patterns.relations import disjoint
from comarmor.patterns.steps import spend

_T = TypeVar("_T")
_V = TypeVar("_V")


class _IndexEntry(Generic[_T]):
    """A pattern and its value, with its matcher once a word is looked up."""

    __slots__ = ("item", "test")

    def __init__(self, item: tuple[Glob, _T]) -> None:
        self.item = item
        self.test: Matcher | None = None


class PatternIndex(Generic[_T]):
    """Finds the patterns that match a word, or that may have a word in common with another pattern.

    Args:
        items: patterns, each with a value.
    """

    def __init__(self, items: Iterable[tuple[Glob, _T]]) -> None:
        self._items = tuple(items)
        self._literals = _PrefixMap[tuple[Glob, _T]]()
        self._wild = _PrefixMap[_PrefixMap[_IndexEntry[_T]]]()
        """Patterns with wildcards by their prefix, then by their reversed suffix."""
        by_prefix: dict[str, _PrefixMap[_IndexEntry[_T]]] = {}
        for item in self._items:
            pattern = item[0]
            text = literal(pattern)
            if text is not None:
                self._literals.add(text, item)
                continue
            head = prefix(pattern)
            if head not in by_prefix:
                by_prefix[head] = _PrefixMap()
                self._wild.add(head, by_prefix[head])
            by_prefix[head].add(suffix(pattern)[::-1], _IndexEntry(item))

    @cached_property
    def _reversed_literals(self) -> _PrefixMap[tuple[Glob, _T]]:
        """The patterns without wildcards by their reversed text; few questions need them."""
        found = _PrefixMap[tuple[Glob, _T]]()
        for item in self._items:
            if (text := literal(item[0])) is not None:
                found.add(text[::-1], item)
        return found

    def __iter__(self) -> Iterator[tuple[Glob, _T]]:
        """Yield all patterns with their values, in the order in which they were given."""
        return iter(self._items)

    def matching(self, word: str) -> Iterator[tuple[Glob, _T]]:
        """Yield the patterns that match a word, with their values."""
        yield from self._literals.equal(word)
        for entries in self._for_word(word):
            for entry in entries:
                test = entry.test
                if test is None:
                    test = entry.test = matcher(entry.item[0])
                if test(word):
                    yield entry.item

    def meeting(self, pattern: Glob) -> Iterator[tuple[Glob, _T]]:
        """Yield the patterns that have a word in common with a pattern, with their values."""
        return (item for item in self.candidates(pattern) if not disjoint(item[0], pattern))

    def candidates(self, pattern: Glob) -> Iterator[tuple[Glob, _T]]:
        """Yield at least the patterns of :meth:`meeting`: those whose prefix and suffix are compatible."""
        text = literal(pattern)
        if text is not None:
            yield from self._literals.equal(text)
            yield from (entry.item for entries in self._for_word(text) for entry in entries)
            return
        head, tail = prefix(pattern), suffix(pattern)[::-1]
        literals = self._literals.extending(head) if head or not tail else self._reversed_literals.extending(tail)
        yield from chain.from_iterable(literals)
        for by_suffix in chain.from_iterable(self._wild.compatible(head)):
            spend()
            yield from (entry.item for entries in by_suffix.compatible(tail) for entry in entries)

    def _for_word(self, word: str) -> Iterator[list[_IndexEntry[_T]]]:
        """Yield the patterns with wildcards whose prefix and suffix a word has."""
        reversed_word = word[::-1]
        for by_suffix in chain.from_iterable(self._wild.prefixes_of(word)):
            yield from by_suffix.prefixes_of(reversed_word)


class _PrefixMap(Generic[_V]):
    """Lists of values by a text."""

    def __init__(self) -> None:
        self._values: dict[str, list[_V]] = {}
        self._lengths: set[int] = set()
        self._sorted: list[str] | None = None

    def add(self, text: str, value: _V) -> None:
        self._values.setdefault(text, []).append(value)
        self._lengths.add(len(text))
        self._sorted = None

    def equal(self, text: str) -> Sequence[_V]:
        return self._values.get(text, ())

    def prefixes_of(self, text: str) -> Iterator[list[_V]]:
        """Yield the values of the prefixes of a text, shorter ones first."""
        for length in sorted(self._lengths):
            if length > len(text):
                return
            if values := self._values.get(text[:length]):
                yield values

    def extending(self, text: str) -> Iterator[list[_V]]:
        """Yield the values of the texts that begin with a text."""
        if self._sorted is None:
            self._sorted = sorted(self._values)
        for index in range(bisect_left(self._sorted, text), len(self._sorted)):
            if not self._sorted[index].startswith(text):
                return
            yield self._values[self._sorted[index]]

    def compatible(self, text: str) -> Iterator[list[_V]]:
        """Yield the values of the texts that begin with a text, or that it begins with."""
        if text:
            yield from self.prefixes_of(text[:-1])
        yield from self.extending(text)
