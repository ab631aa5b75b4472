# SPDX-License-Identifier: Apache-2.0
"""The DDS names that a subject puts into its kind, and what must be alike for two subjects to have alike documents."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations, product

from comarmor.patterns.glob import Glob, literal, matcher, parse, regex
from comarmor.patterns.relations import TooComplexError, intersection
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.patterns.tokens import ANY, Charset
from comarmor.regex import lazy_regex
from comarmor.rules import is_fully_qualified
from comarmor.values import dataclass
from keymint.keymake.kinds import Arguments, Kind
from keymint_ros2_dds.lowering.dds_topics import needed_topics
from keymint_ros2_dds.lowering.name_mapping import ARDENT, dds_patterns

MOST_WILDCARDS = 64
"""Wildcards of a kind: the engine takes subjects with more."""
STEPS = 20_000
"""Steps to intersect these (:mod:`comarmor.patterns.steps`)."""

PLAIN_TEXT = lazy_regex(r"[!#-%'-);=@-Z^-~,-:+]+")
"""Text that every parser and model reads as itself: printable ASCII, without blanks, wildcards, brackets and markup."""

Slot = tuple[str, int, str]
"""A DDS name of a kind: a text, the number of an argument, and a text."""
Signature = tuple[tuple[int, ...], tuple[int, ...]]
"""Which names are equal, and for each name which wildcards match it, as bits."""


@dataclass(frozen=True, slots=True)
class Structure:
    """The DDS names and wildcards of a kind.

    Attributes:
        slots: the names.
        ros: numbers of the arguments that must be ROS names.
        wildcards: the patterns of the policy, and the intersections of any two.
    """

    slots: tuple[Slot, ...]
    ros: frozenset[int]
    wildcards: tuple[Glob, ...]
    _any: re.Pattern[str] | None

    @classmethod
    def of(cls, kind: Kind, distro: str) -> Structure | None:
        """Return the structure of a kind; None if its documents depend on more than :meth:`fit` tells."""
        slots: dict[Slot, None] = {}
        ros: set[int] = set()
        own: dict[Glob, None] = {}
        for effect, rule_kind, permissions, expressions, partitions, _ in kind:
            if partitions or distro == ARDENT:
                return None
            for (topic, tail), each in product(needed_topics(rule_kind, permissions), expressions):
                if isinstance(each, int):
                    slots[topic.prefix, each, tail + topic.suffix] = None
                    if topic.prefix:
                        ros.add(each)
                else:
                    patterns = dds_patterns(distro, parse(each), topic, tail, effect)
                    own.update((pattern, None) for pattern, _ in patterns)
        wildcards = _with_intersections([*own])
        if wildcards is None:
            return None
        match = re.compile("|".join(f"(?:{regex(each)})" for each in wildcards), re.DOTALL) if wildcards else None
        return cls(tuple(slots), frozenset(ros), wildcards, match)

    def fit(self, arguments: Arguments) -> tuple[list[str], Signature] | None:
        """Return the DDS names of a subject, and what subjects with alike documents have in common.

        None if a name may be read in several ways, or is no ROS name.
        """
        for number, argument in enumerate(arguments):
            if not (is_fully_qualified(argument) if number in self.ros else PLAIN_TEXT.fullmatch(argument)):
                return None
        names = [head + arguments[number] + tail for head, number, tail in self.slots]
        first: dict[str, int] = {}
        equal = tuple(first.setdefault(name, index) for index, name in enumerate(names))
        if self._any is None:
            return names, (equal, ())
        match = self._any.fullmatch
        return names, (equal, tuple(self._matches(name) if match(name) else 0 for name in names))

    def _matches(self, name: str) -> int:
        return sum(1 << bit for bit, pattern in enumerate(self.wildcards) if matcher(pattern)(name))


def _with_intersections(patterns: Sequence[Glob]) -> tuple[Glob, ...] | None:
    """Return patterns and the intersections of any two; None if one is a name, has a set, or these are too many.

    The compiler writes intersections where one direction denies what the other allows. A name among them, or among
    the alternatives for a set, is the same text in the documents of all subjects.
    """
    found = dict.fromkeys(patterns)
    try:
        with step_limit(STEPS):
            for pair in combinations(patterns, 2) if len(patterns) <= MOST_WILDCARDS else ():
                found.update(dict.fromkeys(intersection(*pair)))
    except (TooComplexError, StepLimitError):
        return None
    sets = any(isinstance(token, Charset) and token != ANY for pattern in found for token in pattern)
    names = any(literal(pattern) is not None for pattern in found)
    return None if sets or names or len(found) > MOST_WILDCARDS else tuple(found)
