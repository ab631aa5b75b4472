"""What a governance document says of a domain and a topic: whether permissions are asked at all (1.1, 9.4.1.2)."""

from __future__ import annotations

import re
from dataclasses import dataclass

from lxml import etree

from comarmor.errors import ComArmorError
from comarmor.reader import line, parse
from keymint.errors import KeymintError, Origin
from keymint_ros2_dds.decision import fnmatch


@dataclass(frozen=True, slots=True)
class TopicRule:
    """The access control of the topics that an expression matches."""

    expression: str
    read_controlled: bool
    write_controlled: bool
    line: int


@dataclass(frozen=True, slots=True)
class DomainRule:
    """The rules of one domain: the first of the document that is about it."""

    join_controlled: bool
    topic_rules: tuple[TopicRule, ...]

    @property
    def joins_without_rule(self) -> bool:
        """Whether a participant needs no rule to join: joining is not controlled, or some topic is not (1.1, 9.4.3)."""
        return not self.join_controlled or not all(
            rule.read_controlled and rule.write_controlled for rule in self.topic_rules
        )

    def topic_rule(self, topic: str, dialect: fnmatch.Dialect) -> TopicRule | None:
        """Return the first rule that is about a topic."""
        name = fnmatch.in_bytes(topic)
        for rule in self.topic_rules:
            if rule.expression == "*" or re.fullmatch(dialect(fnmatch.in_bytes(rule.expression)), name, re.DOTALL):
                return rule
        return None


def read(content: bytes, domain: int, file: str = "governance.xml") -> DomainRule | None:
    """Return what a governance document says of a domain, or None if it is not about it.

    Raises:
        KeymintError: it cannot be read.
    """
    try:
        root = parse(content, file)
    except ComArmorError as error:
        first = error.diagnostics[0]
        place = Origin(file, first.where.line if first.where else 0)
        raise KeymintError(first.message, where=place, help=first.help, code=first.code) from None
    for element in root.iterfind("domain_access_rules/domain_rule"):
        domains = element.find("domains")
        if domains is not None and any(_covers(item, domain) for item in domains):
            topics = tuple(
                TopicRule(
                    (item.findtext("topic_expression") or "").strip(),
                    _is_true(item, "enable_read_access_control"),
                    _is_true(item, "enable_write_access_control"),
                    line(item),
                )
                for item in element.iterfind("topic_access_rules/topic_rule")
            )
            return DomainRule(_is_true(element, "enable_join_access_control"), topics)
    return None


def _covers(item: etree._Element, domain: int) -> bool:
    if item.tag == "id":
        return (item.text or "").strip() == str(domain)
    low, high = (item.findtext(tag) for tag in ("min", "max"))
    first = int(low) if low and low.strip().isdigit() else 0
    last = int(high) if high and high.strip().isdigit() else None
    return first <= domain and (last is None or domain <= last)


def _is_true(element: etree._Element, tag: str) -> bool:
    return (element.findtext(tag) or "").strip() not in {"false", "0"}
