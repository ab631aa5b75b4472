"""Plain evaluation: what a decision list says of one word. Witnesses are judged by it, and literal patterns are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property

from comarmor.patterns.decision_lists import DecisionList
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.matching import matcher, matches
from comarmor.patterns.tokens import Star

Test = Callable[[str], bool]
FEW = 8
"""So many patterns are tried one by one sooner than an index of them is made."""


def permits(decisions: DecisionList, word: str) -> bool:
    """Tell whether a decision list permits a word: by definition, and without an index."""
    for block in decisions:
        if any(matches(pattern, word) for pattern in block.patterns):
            return block.allows
    return False


class Index:
    """Patterns, found by the texts that they begin or end with.

    Args:
        patterns: patterns, each with a number (that of its block).
    """

    def __init__(self, patterns: Iterable[tuple[Glob, int]]) -> None:
        self._exact: dict[str, tuple[Glob, int]] = {}
        self._heads = _Ends()
        self._tails = _Ends()
        self._inner: list[tuple[Test, Glob, int]] = []
        for pattern, number in patterns:
            text = literal(pattern)
            if text is not None:
                self._exact.setdefault(text, (pattern, number))
                continue
            head = pattern[0] if isinstance(pattern[0], str) else ""
            tail = pattern[-1] if isinstance(pattern[-1], str) else ""
            if len(head) > len(tail):
                self._heads.add(head, (matcher(pattern), pattern, number))
            elif tail:
                self._tails.add(tail[::-1], (matcher(pattern), pattern, number))
            else:
                self._inner.append((_inner(pattern), pattern, number))

    def matching(self, word: str) -> Iterator[tuple[Glob, int]]:
        """Yield the patterns that match a word, with their numbers; of equal literals the first."""
        if word in self._exact:
            yield self._exact[word]
        for near in (self._heads.of(word), self._tails.of(word[::-1]), self._inner):
            for test, pattern, number in near:
                if test(word):
                    yield pattern, number


_Entry = tuple[Test, Glob, int]


class _Ends:
    """Patterns by the text that a word must begin with."""

    def __init__(self) -> None:
        self._by_length: dict[int, dict[str, list[_Entry]]] = {}

    def add(self, text: str, entry: _Entry) -> None:
        self._by_length.setdefault(len(text), {}).setdefault(text, []).append(entry)

    def of(self, word: str) -> Iterator[_Entry]:
        for length, found in self._by_length.items():
            yield from found.get(word[:length], ())


def _inner(pattern: Glob) -> Test:
    match pattern:
        case (Star(), str(text), Star()):
            return lambda word: text in word
    return matcher(pattern)


class Evaluator:
    """Answers as :func:`permits` does, for many words.

    Args:
        decisions: the list.
        literals: take the patterns that match one word only into account.

    Attributes:
        named: the words that a pattern names exactly, and the first block that does.
        wild: the other patterns, and the first block of each.
        effects: what each block does.
    """

    def __init__(self, decisions: DecisionList, *, literals: bool = True) -> None:
        self.effects = [block.allows for block in decisions]
        self.named: dict[str, int] = {}
        self.wild: dict[Glob, int] = {}
        for at, block in enumerate(decisions):
            for pattern in block.patterns:
                text = literal(pattern)
                if text is None:
                    self.wild.setdefault(pattern, at)
                elif literals:
                    self.named.setdefault(text, at)
        self._first_wild = min(self.wild.values(), default=len(decisions))

    def permits(self, word: str) -> bool:
        """Tell whether the list permits a word."""
        first = self.named.get(word, len(self.effects))
        if first > self._first_wild:
            first = self._wildly(word, first)
        return first < len(self.effects) and self.effects[first]

    def permitted(self) -> Iterator[str]:
        """Yield the words that are named exactly, and permitted."""
        for word, at in self.named.items():
            if self.effects[at] if at <= self._first_wild else self.permits(word):
                yield word

    def _wildly(self, word: str, first: int) -> int:
        """Return the first block with a wildcard pattern that matches a word, if it comes before another one."""
        if len(self.wild) > FEW:
            return min((at for _, at in self._index.matching(word) if at < first), default=first)
        for pattern, at in self.wild.items():  # in the order of the blocks
            if at >= first:
                break
            if matches(pattern, word):
                return at
        return first

    @cached_property
    def _index(self) -> Index:
        return Index(self.wild.items())


def shortest(words: Iterable[str]) -> str | None:
    """Return the shortest word, of several the first in order; None of none."""
    return min(words, key=lambda word: (len(word), word), default=None)
