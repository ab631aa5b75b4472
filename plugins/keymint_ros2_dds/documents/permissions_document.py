# SPDX-License-Identifier: Apache-2.0
"""Writes the permissions document: a grant for one subject (DDS Security 1.1, 9.4.1.3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

from lxml import etree

from comarmor.errors import Diagnostic, Severity
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


def render(permissions: Grant, rules: Iterable[GrantRule[str]]) -> bytes:
    """Return the permissions document, indented unless it is large; a pure function of its arguments.

    It is written as text, which is faster than to build a tree first.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be expressed portably across DDS vendors.
    """
    subject = permissions.rules.subject
    period = validity_of(permissions)
    problems = check_domains(permissions.domains, permissions.domains_origin or permissions.origin, subject)
    if period.not_after.year > _MAX_YEAR:
        message = f"the permissions end in the year {period.not_after.year}, which Cyclone DDS reads as expired"
        help_ = f"let them end by {_MAX_YEAR}"
        problems.append(Diagnostic("portability-date", Severity.ERROR, message, permissions.origin, help_, subject))
    if problems:
        raise KeymintError.of(problems)
    name = subject_name_text.of(permissions)
    rules = tuple(rules)
    return dds_xml.indented_if_small(
        lambda indent: "".join(
            (
                f"{dds_xml.start(PERMISSIONS)}\n",
                f"{indent}<permissions>\n",
                f'{indent * 2}<grant name="{permissions.name.translate(_ATTRIBUTE)}">\n',
                f"{indent * 3}<subject_name>{name.translate(_TEXT)}</subject_name>\n",
                f"{indent * 3}<validity>\n",
                f"{indent * 4}<not_before>{dds_xml.date(period.not_before)}</not_before>\n",
                f"{indent * 4}<not_after>{dds_xml.date(period.not_after)}</not_after>\n",
                f"{indent * 3}</validity>\n",
                *(part for rule in rules for part in _rule(rule, permissions.domains, indent)),
                f"{indent * 3}<default>DENY</default>\n",
                f"{indent * 2}</grant>\n",
                f"{indent}</permissions>\n",
                "</dds>",
            )
        )
    )


def _rule(rule: GrantRule[str], domains: tuple[DomainRange, ...], indent: str) -> Iterator[str]:
    """Yield the lines of a rule."""
    tag = "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule"
    yield f"{indent * 3}<{tag}>\n"
    yield _domains(domains, indent)
    for action, expressions in rule.topics.items():
        yield f"{indent * 4}<{action}>\n"
        yield _listed("topic", expressions, indent)
        if rule.partitions != DEFAULT:
            yield _listed("partition", rule.partitions, indent)
        yield f"{indent * 4}</{action}>\n"
    yield f"{indent * 3}</{tag}>\n"


def _listed(tag: str, texts: Iterable[str], indent: str) -> str:
    items = "".join(f"{indent * 6}<{tag}>{text.translate(_TEXT)}</{tag}>\n" for text in texts)
    return f"{indent * 5}<{tag}s>\n{items}{indent * 5}</{tag}s>\n"


@lru_cache(maxsize=64)
def _domains(ranges: tuple[DomainRange, ...], indent: str) -> str:
    rule = etree.Element("rule")
    dds_xml.domains(rule, ranges)
    etree.indent(rule, indent, level=3)
    return f"{indent * 4}{etree.tostring(rule[0], encoding='unicode', with_tail=False)}\n"
