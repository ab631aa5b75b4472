# SPDX-License-Identifier: Apache-2.0
"""Writes the permissions document: a grant for one subject (DDS Security 1.1, 9.4.1.3).

It is written as text, in three parts: what precedes the rules, what is around their lists of topics, and these lists.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

from lxml import etree

from comarmor.errors import Diagnostic
from comarmor.rules import Effect
from keymint.api import DomainRange, Grant
from keymint.errors import KeymintError
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import check_domains
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.lowering.grant_rules import DEFAULT, GrantRule
from keymint_ros2_dds.settings import validity_of

_MAX_YEAR = 2261
"""Cyclone DDS counts time in nanoseconds of 64 bits, and reads later years as expired."""
_ESCAPED = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"}
_TEXT = str.maketrans(_ESCAPED)
_ATTRIBUTE = str.maketrans({**_ESCAPED, '"': "&quot;", "\n": "&#10;", "\t": "&#9;"})


Around = Sequence[str]
"""The text before each list of topics of some rules, and after the last one, to the end of the document."""


def render(permissions: Grant, rules: Sequence[GrantRule[str]]) -> bytes:
    """Return the permissions document, indented unless it is large; a pure function of its arguments.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be expressed portably across DDS vendors.
    """
    begin = head(permissions)

    def write(indent: str) -> str:
        return text(begin[indent], rules, around_topics(rules, permissions.domains, indent), indent)

    return dds_xml.indented_if_small(write)


def head(permissions: Grant) -> Mapping[str, str]:
    """Return the text before the rules of a document, for each indentation.

    Raises:
        KeymintError: see :func:`render`.
    """
    subject = permissions.rules.subject
    period = validity_of(permissions)
    problems = [*check_domains(permissions.domains, permissions.domains_origin or permissions.origin, subject)]
    if period.not_after.year > _MAX_YEAR:
        message = f"the permissions end in the year {period.not_after.year}, which Cyclone DDS reads as expired"
        help_ = f"let them end by {_MAX_YEAR}"
        problems.append(Diagnostic.error("portability-date", message, permissions.origin, help_, subject))
    if problems:
        raise KeymintError.of(problems)
    name = subject_name_text.of(permissions).translate(_TEXT)
    label = permissions.name.translate(_ATTRIBUTE)
    begin, end = dds_xml.date(period.not_before), dds_xml.date(period.not_after)
    return {
        indent: (
            f"{dds_xml.start(PERMISSIONS)}\n"
            f"{indent}<permissions>\n"
            f'{indent * 2}<grant name="{label}">\n'
            f"{indent * 3}<subject_name>{name}</subject_name>\n"
            f"{indent * 3}<validity>\n"
            f"{indent * 4}<not_before>{begin}</not_before>\n"
            f"{indent * 4}<not_after>{end}</not_after>\n"
            f"{indent * 3}</validity>\n"
        )
        for indent in dds_xml.INDENTATIONS
    }


def text(begin: str, rules: Iterable[GrantRule[str]], around: Around, indent: str) -> str:
    """Return a document as text.

    Args:
        begin: from :func:`head`.
        rules: its rules, for their lists of topics.
        around: from :func:`around_topics`.
        indent: what each level is indented by.
    """
    parts = [begin]
    following = iter(around)
    for topics in (topics for rule in rules for topics in rule.topics.values()):
        parts += next(following), _elements("topic", topics, indent)
    return "".join((*parts, *following))


def around_topics(rules: Iterable[GrantRule[str]], domains: tuple[DomainRange, ...], indent: str) -> Around:
    """Return the text around the lists of topics of some rules."""
    texts = [""]
    for rule in rules:
        tag = "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule"
        texts[-1] += f"{indent * 3}<{tag}>\n{_domains(domains, indent)}"
        for action in rule.topics:
            texts[-1] += f"{indent * 4}<{action}>\n{indent * 5}<topics>\n"
            texts.append(f"{indent * 5}</topics>\n")
            if rule.partitions != DEFAULT:
                partitions = _elements("partition", rule.partitions, indent)
                texts[-1] += f"{indent * 5}<partitions>\n{partitions}{indent * 5}</partitions>\n"
            texts[-1] += f"{indent * 4}</{action}>\n"
        texts[-1] += f"{indent * 3}</{tag}>\n"
    texts[-1] += f"{indent * 3}<default>DENY</default>\n{indent * 2}</grant>\n{indent}</permissions>\n</dds>"
    return texts


def _elements(tag: str, texts: Sequence[str], indent: str) -> str:
    joined = "".join(texts)
    if any(char in joined for char in _ESCAPED):
        texts = [text.translate(_TEXT) for text in texts]
    begin, end = f"{indent * 6}<{tag}>", f"</{tag}>\n"
    return f"{begin}{(end + begin).join(texts)}{end}"


@lru_cache(maxsize=64)
def _domains(ranges: tuple[DomainRange, ...], indent: str) -> str:
    rule = etree.Element("rule")
    dds_xml.domains(rule, ranges)
    etree.indent(rule, indent, level=3)
    return f"{indent * 4}{etree.tostring(rule[0], encoding='unicode', with_tail=False)}\n"
