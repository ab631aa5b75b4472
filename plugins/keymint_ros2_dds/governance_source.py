# SPDX-License-Identifier: Apache-2.0
"""Governance: the protection of domains and topics, from a package's document and its defaults."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

from comarmor.errors import Defects, Diagnostic, Origin
from comarmor.text import quoted
from comarmor.values import dataclass
from comarmor.xml.reader import line
from keymint.api import DomainRange, Grant, PackageSettings, PackageSources, SourcePart
from keymint.api.source_documents import DEFAULT_DOMAINS, Reader, domains, incomplete, signer, text
from keymint.errors import KeymintError
from keymint_ros2_dds.settings import STRICT_DOMAIN, STRICT_TOPIC, DdsSettings, DomainRule, Governance, TopicProtection

if TYPE_CHECKING:
    from lxml import etree

PART = "governance"
"""Name of the part of a package that this module reads."""
OPEN_GOVERNANCE = "open_governance"
"""What a profile accepts that leaves topics without access control."""
KEY_URIS = "token_keys"
"""What a profile accepts that only participants of Fast DDS can use."""


def settings(sources: PackageSources) -> PackageSettings:
    """Return the governance of a package: see :meth:`keymint.api.BuildType.settings`.

    Raises:
        KeymintError: with ``file:line`` of each defect, also of a grant that is incomplete for DDS.
    """
    defects = Defects()
    governance = defects.attempt(partial(_governance, sources, sources.parts[PART]))
    if sources.grant:
        defects.found += _grant_defects(sources.grant)
    if governance is None or defects.found:
        raise KeymintError.of(defects.found)
    if sources.grant and sources.grant.issuer != governance.issuer:
        raise KeymintError(
            f"permissions are signed by {sources.grant.issuer!r}, governance by {governance.issuer!r}",
            where=sources.parts[PART].where,
            help="use the same authority for both: a DDS participant verifies both with one certificate",
            code="signers-differ",
        )
    return PackageSettings(DdsSettings(governance, KEY_URIS in sources.accepts))


def _governance(sources: PackageSources, part: SourcePart) -> Governance:
    own = () if part.content is None else _read(part.content, part.file)
    if part.defaults is None:
        raise KeymintError(
            f"there is no file {quoted(part.defaults_file, 200)} in the package or its profile",
            where=part.where,
            help="create it, or correct the path",
            code="file-missing",
        )
    defaults = _read_defaults(part.defaults, part.defaults_file)
    defaults_at = Origin(part.defaults_file, defaults.line)
    usual = defaults.issuer or (sources.grant.issuer if sources.grant else "")
    issuer = signer(part.issuer, part.where, usual, defaults_at, sources.authorities)
    rules = _complete(own, part.file, *_base(part.defaults, part.defaults_file))
    return Governance(issuer, rules, accepts_open=OPEN_GOVERNANCE in sources.accepts)


def _grant_defects(grant: Grant) -> Iterator[Diagnostic]:
    """Yield what a grant lacks: it must have a subject name and a validity (DDS Security 1.1, 9.4.1.3)."""
    missing = "subject_name" if not grant.subject_name else "validity" if grant.validity is None else ""
    if missing:
        yield from incomplete("grant", missing, grant.defaults_origin or grant.origin).diagnostics


@dataclass(frozen=True, slots=True)
class _TopicRuleElement:
    """A ``<topic_rule>``, ``<ros_service_rule>`` and so on.

    Attributes:
        settings: the settings that it gives, by tag.
    """

    line: int
    kind: str
    expression: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class _DomainRuleElement:
    """A ``<domain_rule>``, or the ``<defaults>`` of all.

    Attributes:
        issuer: name of the authority that signs the governance; empty if not given.
        domains: empty if not given.
        settings: the settings that it gives, by tag.
    """

    line: int
    issuer: str
    domains: tuple[DomainRange, ...]
    settings: Mapping[str, Any]
    topic_rules: tuple[_TopicRuleElement, ...]


def _domain_rule_element(element: etree._Element) -> _DomainRuleElement:
    return _DomainRuleElement(
        line=line(element),
        issuer=text(element.find("issuer_name")) or "",
        domains=domains(element.find("domains")),
        settings=_settings(element, STRICT_DOMAIN),
        topic_rules=tuple(_topic_rule_element(rule) for rule in element.iterfind("topic_access_rules/*")),
    )


def _topic_rule_element(element: etree._Element) -> _TopicRuleElement:
    kind = str(element.tag).removesuffix("_rule")
    expression = element.find(f"{kind.removeprefix('ros_')}_expression")
    return _TopicRuleElement(line(element), kind, text(expression) or "", _settings(element, STRICT_TOPIC))


def _settings(element: etree._Element, known: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings that an element gives: kinds of protection as text, others as booleans."""
    return {
        str(part.tag): text(part) if str(part.tag).endswith("_kind") else text(part) in {"true", "1"}
        for part in element
        if part.tag in known
    }


_read = Reader(
    "keymint_ros2_dds",
    "source_governance",
    lambda root: tuple(_domain_rule_element(rule) for rule in root.iterfind("domain_access_rules/domain_rule")),
)
"""Reads the domain rules of a package, in order."""
_read_defaults = Reader("keymint_ros2_dds", "source_governance_defaults", _domain_rule_element)
"""Reads the defaults of a domain rule."""


@lru_cache(maxsize=64)
def _base(content: bytes, file: str) -> tuple[DomainRule, Mapping[str, Any]]:
    """Return the domain rule that the defaults describe, and their settings for every topic.

    Args:
        content: the defaults.
        file: their document, for origins.
    """
    defaults = _read_defaults(content, file)
    general: Mapping[str, Any] = next(
        (rule.settings for rule in defaults.topic_rules if (rule.kind, rule.expression) == ("topic", "*")), {}
    )
    rule = DomainRule(
        domains=defaults.domains or DEFAULT_DOMAINS,
        topic_rules=tuple(_topic_protection(rule, general, file) for rule in defaults.topic_rules),
        origin=Origin(file, defaults.line),
        **{**STRICT_DOMAIN, **defaults.settings},
    )
    return rule, general


def _complete(
    own: Iterable[_DomainRuleElement], file: str, base: DomainRule, general: Mapping[str, Any]
) -> tuple[DomainRule, ...]:
    """Return the domain rules that a package and its defaults describe together.

    A domain rule's own topic rules come before those of the defaults, since the first one that matches a topic decides.
    A topic rule takes the settings that it leaves out from the defaults' rule for every topic.

    Args:
        own: the domain rules of the package. If it has none, the defaults become the only rule.
        file: the package's document, for origins.
        base: the domain rule of the defaults.
        general: settings of the defaults for every topic.
    """
    rules = tuple(
        replace(
            base,
            domains=rule.domains or base.domains,
            topic_rules=(*(_topic_protection(topic, general, file) for topic in rule.topic_rules), *base.topic_rules),
            origin=Origin(file, rule.line),
            domains_origin=None if rule.domains else base.origin,
            **rule.settings,
        )
        for rule in own
    )
    return rules or (base,)


def _topic_protection(rule: _TopicRuleElement, general: Mapping[str, Any], file: str) -> TopicProtection:
    settings = {**STRICT_TOPIC, **general, **rule.settings}
    return TopicProtection(rule.kind, rule.expression, origin=Origin(file, rule.line), **settings)
