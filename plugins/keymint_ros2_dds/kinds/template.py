# SPDX-License-Identifier: Apache-2.0
"""The rules of a grant with places for the names of a subject."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from comarmor.rules import Effect
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import GrantRule, Partitions, is_name

_Texts = tuple[tuple[int, ...], tuple[str, ...]]
"""Numbers of names, and expressions that are the same for all subjects."""


@dataclass(frozen=True, slots=True)
class Template:
    """Rules of a grant with places for names: effect, partitions and topics of each."""

    rules: tuple[tuple[Effect, Partitions, tuple[tuple[TopicAction, _Texts], ...]], ...]

    @classmethod
    def of(cls, rules: Sequence[GrantRule[str]], names: Sequence[str]) -> Template:
        """Return the template of some rules.

        Args:
            rules: rules that the engine made for a subject.
            names: the DDS names of the subject; other topics of the rules are the same for all subjects.
        """
        numbers: dict[str, int] = {}
        for number, name in enumerate(names):
            numbers.setdefault(name, number)

        def split(texts: Sequence[str]) -> _Texts:
            own = tuple(numbers[text] for text in texts if text in numbers)
            return own, tuple(text for text in texts if text not in numbers)

        return cls(
            tuple(
                (rule.effect, rule.partitions, tuple((action, split(texts)) for action, texts in rule.topics.items()))
                for rule in rules
            )
        )

    def renamed(self, names: Sequence[str]) -> tuple[GrantRule[str], ...]:
        """Return the rules for another subject, each list of topics sorted as the compiler does."""
        return tuple(
            GrantRule(effect, partitions, self._topics(topics, names)) for effect, partitions, topics in self.rules
        )

    def has_no_names(self) -> bool:
        """Tell whether every topic that is the same for all subjects is an expression with a wildcard."""
        shared = (text for *_, topics in self.rules for _, (_, texts) in topics for text in texts)
        return not any(map(is_name, shared))

    @staticmethod
    def _topics(
        topics: tuple[tuple[TopicAction, _Texts], ...], names: Sequence[str]
    ) -> Mapping[TopicAction, tuple[str, ...]]:
        return {
            action: tuple(sorted([*(names[number] for number in own), *shared])) for action, (own, shared) in topics
        }
