# SPDX-License-Identifier: Apache-2.0
"""Find likely typos: similar names where one of them would fit the other's use.

Names that differ by a typing mistake are found by a walk through a trie instead of comparing all pairs.
"""

from __future__ import annotations

import difflib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache

from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.steps import StepLimitError, spend, step_counting_cache, step_limit
from comarmor.rules import KIND_OF, Effect, is_fully_qualified
from comarmor.text import lazy_regex
from keymint.analysis.findings import ExpressionOrigins, undecided_note
from keymint.api import PolicyStructure
from keymint.errors import Diagnostic, Origin
from keymint.ir import Rule

_PAIRS = (
    ("publish", "subscribe"),
    ("ros_publish", "ros_subscribe"),
    ("ros_call", "ros_execute"),
    ("ros_request", "ros_operate"),
)
_PEERS = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
"""The permission of the peer, by permission."""
MOST_EDITS = 2
"""Maximum number of edits between a name and a misspelling of it."""
_SHORTEST = 4
_SIMILAR = 0.8
"""Minimum similarity of two names by :meth:`difflib.SequenceMatcher.ratio`."""
_FEW = 64
"""Maximum number of compared names with the same words."""
STEPS = 2_000
"""Maximum steps of the search for one name."""
_DIGITS = lazy_regex(r"\d+")


def similar_names(subjects: Mapping[str, tuple[Rule, ...]], attachments: ExpressionOrigins) -> Iterator[Diagnostic]:
    """Yield names without a peer where a similar name lacks exactly this peer, or has it and differs by a slip.

    Args:
        subjects: the rules of each subject that a policy names.
        attachments: attachments of their expressions.
    """
    exact, wild = _allowed(subjects)
    wilds = {permission: PatternIndex((pattern, None) for pattern in patterns) for permission, patterns in wild.items()}

    def has_no_peer(permission: str, name: str) -> bool:
        other = _PEERS[permission]
        matching = wilds[other].meeting((name,)) if other in wilds else ()
        return name not in exact[other] and not any(True for _ in matching)

    reported: set[frozenset[str]] = set()
    given_up: list[str] = []
    lone = {each: {name: None for name in exact[each] if has_no_peer(each, name)} for each in _PEERS}
    for permission, other in _PEERS.items():
        if not lone[permission]:
            continue
        candidates = CandidateNames(lone[other])
        paired = CandidateNames(name for name in exact[other] if name not in lone[other])
        for name in lone[permission]:
            near = candidates.nearest(name, MOST_EDITS, given_up)
            if not near:
                near = paired.nearest(name, MOST_EDITS, given_up)
                near = near if near and _is_slip(name, near) else None
            if near and frozenset((name, near)) not in reported:
                subject, rule, text = exact[permission][name]
                reported.add(frozenset((name, near)))
                peer, peer_rule, peer_text = exact[other][near]
                peer_place = attachments.of(peer_rule, peer)[peer_text].where.alone()
                yield Diagnostic.warning(
                    "name-similar",
                    f"{subject} may {_plain(permission)} the {KIND_OF[permission]} {name!r} "
                    f"and nobody may {_plain(other)} it, but {peer} may {_plain(other)} {near!r} ({peer_place})",
                    attachments.of(rule, subject)[text].where,
                    f"if one of the two is misspelt, write the same name in both places: {name!r} or {near!r}",
                    subject,
                )
    yield from _unknown(given_up)


def similar_subjects(written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield subjects in one profile where several profiles name a subject that differs in a single character."""
    named: dict[str, dict[Origin, Origin]] = defaultdict(dict)
    for profile in written.profiles:
        for expression, where in profile.attachments:
            name = literal(parse(expression))
            if name is not None:
                named[name][profile.where] = where
    given_up: list[str] = []
    often = CandidateNames(name for name, places in named.items() if len(places) > 1)
    for name, places in named.items():
        near = often.nearest(name, 1, given_up) if len(places) == 1 else None
        if near:
            message = f"one profile applies to the subject {name!r}, and {len(named[near])} apply to {near!r}"
            yield Diagnostic.warning("name-similar", message, next(iter(places.values())), f"did you mean {near!r}?")
    yield from _unknown(given_up)


def _allowed(
    subjects: Mapping[str, tuple[Rule, ...]],
) -> tuple[dict[str, dict[str, tuple[str, Rule, str]]], dict[str, dict[Glob, None]]]:
    """Return, by permission, the exact names that are allowed, with a subject, rule and expression, and the patterns.

    Names that no object can have are left out: they are reported as such.
    """
    exact: dict[str, dict[str, tuple[str, Rule, str]]] = defaultdict(dict)
    wild: dict[str, dict[Glob, None]] = defaultdict(dict)
    for subject, rules in subjects.items():
        for rule in rules:
            if rule.effect is not Effect.ALLOW:
                continue
            for expression in rule.expressions:
                pattern = parse(expression)
                name = literal(pattern)
                for permission in rule.permissions:
                    if name is None:
                        wild[permission][pattern] = None
                    elif rule.kind == "topic" or is_fully_qualified(name):
                        exact[permission].setdefault(name, (subject, rule, expression))
    return exact, wild


def _plain(permission: str) -> str:
    plain = permission.removeprefix("ros_")
    return f"{plain} to" if plain == "subscribe" else plain


def _unknown(given_up: Sequence[str]) -> Iterator[Diagnostic]:
    """Yield a note on names that were not compared with all others."""
    if given_up:
        others = f" and {len(given_up) - 1:,} others" if len(given_up) > 1 else ""
        yield undecided_note(
            f"names similar to {given_up[0]!r}{others} are unknown: too many to compare within {STEPS:,} steps",
            "check these names yourself, or lint parts of the policy",
        )


class CandidateNames:
    """Names to compare with.

    The search ignores numbers: names that differ only in numbers are not typos.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._by_words: dict[str, list[str]] = defaultdict(list)
        self._by_numbers: dict[tuple[str, tuple[str, ...]], list[str]] = defaultdict(list)
        for name in names:
            if len(name) >= _SHORTEST:
                words, numbers = _parted(name)
                self._by_words[words].append(name)
                self._by_numbers[words, numbers].append(name)
        trie = NameTrie(self._by_words)
        # Names of a fleet differ in numbers only, so most have the same words.
        self._near = step_counting_cache(lambda words, most: tuple(trie.near(words, most)))

    def nearest(self, name: str, most: int, given_up: list[str]) -> str | None:
        """Return the most similar name within some edits that does not differ only in numbers.

        Of the names with the same words, those with the numbers of the name are compared, or else a few.

        Args:
            name: the name.
            most: the number of edits.
            given_up: receives the name if there are too many similar names.
        """
        if len(name) < _SHORTEST or not self._by_words:
            return None
        words, numbers = _parted(name)
        best = (0.0, "")
        try:
            with step_limit(STEPS + 1):  # one is for the look at what is known
                for other in self._near(words, most):
                    likely = self._by_numbers.get((other, numbers)) or self._by_words[other][:_FEW]
                    for near in likely if other != words else ():
                        spend(len(name))
                        ratio = difflib.SequenceMatcher(None, name, near).ratio()
                        if ratio >= _SIMILAR and _edits(name, near) <= most:
                            best = max(best, (ratio, near))
        except StepLimitError:
            given_up.append(name)
            return None
        return best[1] or None


@lru_cache(1 << 16)
def _parted(name: str) -> tuple[str, tuple[str, ...]]:
    """Return a name without its numbers, and these."""
    return _DIGITS.sub("", name), tuple(_DIGITS.findall(name))


def _is_slip(one: str, other: str) -> bool:
    """Whether names differ by a letter too many or two letters that changed places: no pair of names means that."""
    return sorted(one) == sorted(other) or (len(one) != len(other) and _edits(one, other) == 1)


def _edits(one: str, other: str) -> int:
    steps = difflib.SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
    return sum(max(high - low, high2 - low2) for tag, low, high, low2, high2 in steps if tag != "equal")


_END = ""
"""The branch of a node that holds the name that ends there."""


class NameTrie:
    """Finds names by their edit distance.

    Args:
        names: names.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._root: dict[str, object] = {}
        for name in dict.fromkeys(names):
            node = self._root
            for char in name:
                node = node.setdefault(char, {})  # type: ignore[assignment]
            node[_END] = name

    def near(self, name: str, most: int) -> Iterator[str]:
        """Yield the names within a number of insertions, deletions and replacements of characters.

        V. I. Levenshtein, "Binary codes capable of correcting deletions, insertions, and reversals", 1966. Every branch
        of the trie that is visited counts as a step.
        """
        first = {length: length for length in range(min(most, len(name)) + 1)}
        todo: list[tuple[dict[str, object], dict[int, int]]] = [(self._root, first)]
        while todo:
            node, row = todo.pop()
            spend(2 + 2 * len(node))
            for char, below in node.items():
                if char == _END:
                    if row.get(len(name), most + 1) <= most:
                        yield str(below)
                    continue
                next_row = _next_row(name, row, char, most)
                if next_row and isinstance(below, dict):
                    todo.append((below, next_row))


def _next_row(name: str, row: dict[int, int], char: str, most: int) -> dict[int, int]:
    """Return the fewest edits for each length of a prefix of the name, after one more character of another name."""
    edits_by_length: dict[int, int] = {}
    for length in sorted({*row, *(each + 1 for each in row)}):
        if length > len(name):
            break
        edits = row.get(length, most) + 1
        if length:
            replaced = row.get(length - 1, most + 1) + (name[length - 1] != char)
            edits = min(edits, replaced, edits_by_length.get(length - 1, most) + 1)
        if edits <= most:
            edits_by_length[length] = edits
    last = max(edits_by_length, default=len(name))
    while last < len(name) and edits_by_length[last] < most:
        edits_by_length[last + 1] = edits_by_length[last] + 1
        last += 1
    return edits_by_length
