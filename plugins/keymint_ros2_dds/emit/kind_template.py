# SPDX-License-Identifier: Apache-2.0
"""The rules of a grant with places for the names of a subject."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint.api import DomainRange
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.documents.permissions_document import Around
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import GrantRule, Partitions, is_name

_Texts = tuple[tuple[int, ...], tuple[str, ...]]
"""Numbers of names, and expressions that are the same for all subjects."""


@dataclass(frozen=True, slots=True)
class Template:
    """Rules of a grant with places for names.

    Attributes:
        rules: effect, partitions and topics of each rule.
        around: the text of a document around the lists of topics, for each indentation.
        places: the number of the name in each place.
        sizes: bytes of a document without its head and names, for each indentation.
    """

    rules: tuple[tuple[Effect, Partitions, tuple[tuple[TopicAction, _Texts], ...]], ...]
    around: Mapping[str, Around]
    places: tuple[int, ...]
    sizes: Mapping[str, int]

    @classmethod
    def of(cls, rules: Sequence[GrantRule[str]], domains: tuple[DomainRange, ...], names: Sequence[str]) -> Template:
        """Return the template of some rules.

        Args:
            rules: rules that the engine made for a subject.
            domains: the domains of its grant.
            names: the DDS names of the subject; other topics of the rules are the same for all subjects.
        """
        numbers: dict[str, int] = {}
        for number, name in enumerate(names):
            numbers.setdefault(name, number)

        def split(texts: Sequence[str]) -> _Texts:
            own = tuple(numbers[text] for text in texts if text in numbers)
            return own, tuple(text for text in texts if text not in numbers)

        split_rules = tuple(
            (rule.effect, rule.partitions, tuple((action, split(texts)) for action, texts in rule.topics.items()))
            for rule in rules
        )
        around = {each: permissions_document.around_topics(rules, domains, each) for each in dds_xml.INDENTATIONS}
        places = tuple(number for *_, topics in split_rules for _, (own, _) in topics for number in own)
        length = sum(len(names[number]) for number in places)
        sizes = {
            each: len(permissions_document.text("", rules, around[each], each).encode()) - length
            for each in dds_xml.INDENTATIONS
        }
        return cls(split_rules, around, places, sizes)

    def renamed(self, names: Sequence[str]) -> tuple[GrantRule[str], ...]:
        """Return the rules for another subject, each list of topics sorted as the compiler does."""
        return tuple(
            GrantRule(
                effect,
                partitions,
                {
                    action: tuple(sorted([*(names[number] for number in own), *shared]))
                    for action, (own, shared) in topics
                },
            )
            for effect, partitions, topics in self.rules
        )

    def document(self, head: Mapping[str, str], rules: Sequence[GrantRule[str]]) -> bytes:
        """Return the document of another subject, from its head and rules."""
        return dds_xml.indented_if_small(
            lambda indent: permissions_document.text(head[indent], rules, self.around[indent], indent)
        )

    def size(self, head: Mapping[str, str], names: Sequence[str]) -> int:
        """Return the bytes of the document of another subject, from its head and names."""
        length = sum(len(names[number]) for number in self.places)
        return dds_xml.size_if_small(lambda indent: len(head[indent]) + self.sizes[indent] + length)

    def has_no_names(self) -> bool:
        """Tell whether every topic that is the same for all subjects is an expression with a wildcard."""
        shared = (text for *_, topics in self.rules for _, (_, texts) in topics for text in texts)
        return not any(map(is_name, shared))
