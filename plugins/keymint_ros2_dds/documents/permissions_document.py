# SPDX-License-Identifier: Apache-2.0
"""Writes the permissions document, as text: a grant for one subject (DDS Security 1.1, 9.4.1.3)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from lxml import etree

from comarmor.rules import Effect
from keymint.api import DomainRange, Grant
from keymint.errors import Diagnostic, require_none
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import check_domains
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, GrantRule
from keymint_ros2_dds.settings import validity_of
from keymint_ros2_dds.subject_names import subject_name_of

_MAX_YEAR = 2261
"""Cyclone DDS counts time in nanoseconds of 64 bits, and reads later years as expired."""
_ESCAPED = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"}
_TEXT = str.maketrans(_ESCAPED)
_ATTRIBUTE = str.maketrans({**_ESCAPED, '"': "&quot;", "\n": "&#10;", "\t": "&#9;"})


def render(permissions: Grant, rules: Sequence[GrantRule[str]]) -> bytes:
    """Return the permissions document, indented unless it is large; a pure function of its arguments.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be expressed portably across DDS vendors.
    """
    subject, period = permissions.rules.subject, validity_of(permissions)
    problems = [*check_domains(permissions.domains, permissions.domains_origin or permissions.origin, subject)]
    if period.not_after.year > _MAX_YEAR:
        message = f"the permissions end in the year {period.not_after.year}, which Cyclone DDS reads as expired"
        help_ = f"let them end by {_MAX_YEAR}"
        problems.append(Diagnostic.error("portability-date", message, permissions.origin, help_, subject))
    require_none(problems)
    name = subject_name_of(permissions)
    return dds_xml.indented_if_small(lambda indent: _text(permissions, name, rules, indent))


def _text(permissions: Grant, name: str, rules: Sequence[GrantRule[str]], indent: str) -> str:
    """Return the document of a subject name, without declaration."""
    period, domains = validity_of(permissions), _domains(permissions.domains, indent)
    head = (
        f"{dds_xml.start(PERMISSIONS)}\n"
        f"{indent}<permissions>\n"
        f'{indent * 2}<grant name="{permissions.name.translate(_ATTRIBUTE)}">\n'
        f"{indent * 3}<subject_name>{name.translate(_TEXT)}</subject_name>\n"
        f"{indent * 3}<validity>\n"
        f"{indent * 4}<not_before>{dds_xml.date(period.not_before)}</not_before>\n"
        f"{indent * 4}<not_after>{dds_xml.date(period.not_after)}</not_after>\n"
        f"{indent * 3}</validity>\n"
    )
    parts = [head]
    for rule in rules:
        tag = "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule"
        parts.append(f"{indent * 3}<{tag}>\n{domains}")
        for action, topics in rule.topics.items():
            partitions = "" if rule.partitions == DEFAULT else _list("partition", rule.partitions, indent)
            criteria = _list("topic", topics, indent) + partitions
            parts.append(f"{indent * 4}<{action}>\n{criteria}{indent * 4}</{action}>\n")
        parts.append(f"{indent * 3}</{tag}>\n")
    parts.append(f"{indent * 3}<default>DENY</default>\n{indent * 2}</grant>\n{indent}</permissions>\n</dds>")
    return "".join(parts)


def _list(tag: str, texts: Sequence[str], indent: str) -> str:
    joined = "".join(texts)
    if any(each in joined for each in _ESCAPED):
        texts = [text.translate(_TEXT) for text in texts]
    begin, end = f"{indent * 6}<{tag}>", f"</{tag}>\n"
    elements = f"{begin}{(end + begin).join(texts)}{end}"
    return f"{indent * 5}<{tag}s>\n{elements}{indent * 5}</{tag}s>\n"


@lru_cache(maxsize=64)
def _domains(ranges: tuple[DomainRange, ...], indent: str) -> str:
    rule = etree.Element("rule")
    dds_xml.domains(rule, ranges)
    etree.indent(rule, indent, level=3)
    return f"{indent * 4}{etree.tostring(rule[0], encoding='unicode', with_tail=False)}\n"
