# SPDX-License-Identifier: Apache-2.0
"""The governance document of an enclave, and which of its openings the sources accept."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import pairwise

from comarmor.patterns.tokens import PatternError
from keymint.api import DomainRange, Package
from keymint_ros2_dds.decision.semantics import STANDARD, Semantics
from keymint_ros2_dds.documents import governance_document
from keymint_ros2_dds.proving.governance_lists import is_closed, patterns
from keymint_ros2_dds.reading import signed_governance
from keymint_ros2_dds.reading.signed_governance import (
    ACCESS,
    JOIN,
    UNAUTHENTICATED,
    DocumentDomainRule,
    GovernanceDocument,
)
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains
from keymint_ros2_dds.settings import settings_of

ACTIONS = ("publish", "subscribe")
LAST_DOMAIN = 232
"""The highest domain id whose ports exist for any participant (DDSI-RTPS 2.3, 9.6.1.1)."""


class EnclaveGovernance:
    """A signed governance document, and the one that the sources compile to.

    Args:
        content: the document, unsigned.
        place: its file, and the number of lines before it there.
        package: the sources of the enclave, if there are any.

    Attributes:
        document: the document.
        sources: what the sources compile to; None if there are no sources.
        differs: the document differs from what the sources compile to, in any byte.

    Raises:
        KeymintError: the document cannot be read, or the sources cannot be expressed as a document.
    """

    def __init__(self, content: bytes, place: tuple[str, int], package: Package | None) -> None:
        built, self._accepted = b"", False
        if package is not None:
            governance = settings_of(package).governance
            built, _ = governance_document.build(
                governance, package.subject, package.distro, allow_vendor_specific=True
            )
            self._accepted = governance.accepts_open
        self.document = signed_governance.read(content, *place)
        self.sources = signed_governance.read(built) if built else None
        self.differs = content != built
        self._contents = content, place, built, self._accepted

    @property
    def key(self) -> bytes:
        """A digest of all that claims depend on."""
        return hashlib.sha256(repr(self._contents).encode()).digest()

    def domains(self) -> Iterator[DocumentDomains]:
        """Yield the ranges of domains of both documents."""
        for document in filter(None, (self.document, self.sources)):
            for rule in document.domain_rules:
                yield from rule.domains

    def source_rule(self, domain: int) -> DocumentDomainRule | None:
        """Return the rule of the sources that applies in a domain."""
        return None if self.sources is None else self.sources.rule(domain)

    def accepted_rule(self, domain: int) -> DocumentDomainRule | None:
        """Return the rule whose openings are accepted in a domain."""
        return self.source_rule(domain) if self._accepted else None

    def transparent(self, domains: tuple[DomainRange, ...]) -> bool:
        """Tell whether the permissions alone decide, as every implementation reads the document.

        Then it is plain, each domain has a rule, and each rule puts joining and every topic under access control.

        Args:
            domains: the domains of the policy.
        """
        return not self.differs and _transparent(self._contents[0], domains)

    def opens(self) -> bool:
        """Tell whether any rule leaves a topic open."""
        return any(rule.opens for rule in self.document.domain_rules)

    def excepted(self, rule: DocumentDomainRule, action: str, domain: int) -> Iterator[str]:
        """Yield what a rule of the document leaves open in a domain, and the profile accepts."""
        own = self.accepted_rule(domain)
        if own is None:
            return
        where = f" in domain {domain}" if domain else ""
        for topic in rule.topic_rules:
            if not topic.controls(action):
                place = self.document.place(topic.line)
                yield f"{action} {topic.expression!r}{where} ({place}: {ACCESS[action]} is false)"
        if not rule.join_controlled and not own.join_controlled:
            yield f"joining{where or ' domain 0'} ({self.document.place(rule.line_of(JOIN))}: {JOIN} is false)"
        if rule.unauthenticated and own.unauthenticated:
            place = self.document.place(rule.line_of(UNAUTHENTICATED))
            yield f"participants without identity{where or ' in domain 0'} ({place}: {UNAUTHENTICATED} is true)"


# Enclaves usually have the same governance.
@lru_cache(maxsize=64)
def _transparent(content: bytes, domains: tuple[DomainRange, ...]) -> bool:
    document = signed_governance.read(content)
    if document.quirks or unread_topic(document, STANDARD):
        return False
    closed = all(
        rule.join_controlled and not rule.unauthenticated and is_closed(rule, STANDARD)
        for rule in document.domain_rules
    )
    exact = all(
        item.last is not None and item.first is not None for rule in document.domain_rules for item in rule.domains
    )
    wanted = {domain for item in domains for domain in range(item.first, item.last + 1)}
    return closed and exact and all(document.rule(domain) is not None for domain in wanted)


def unread_topic(document: GovernanceDocument, semantics: Semantics) -> str:
    """Return which expression has no meaning, or one that depends on the locale of a process; or an empty text."""
    for topic in (topic for rule in document.domain_rules for topic in rule.topic_rules):
        if not topic.expression.isascii() or "[:" in topic.expression:
            what = f"the expression {topic.expression!r} has characters beyond ASCII, or a class"
            return f"{document.place(topic.line)}: {what}: what it matches depends on the locale"
        try:
            patterns(topic.expression, semantics, pairs=False)
        except PatternError as error:
            return f"{document.place(topic.line)}: {error}"
    return ""


def cuts(ranges: Iterable[DocumentDomains | DomainRange]) -> Iterator[DomainRange]:
    """Yield ranges of domains such that each given range contains all or none of the domains of each one."""
    edges = {0, LAST_DOMAIN + 1}
    for domains in ranges:
        first = domains.first or 0
        edges |= {first, first + 1, *(() if domains.last is None else (domains.last + 1,))}
    for begin, end in pairwise(sorted(edge for edge in edges if 0 <= edge <= LAST_DOMAIN + 1)):
        yield DomainRange(begin, end - 1)
