# SPDX-License-Identifier: Apache-2.0
"""The governance document of an enclave: which of its openings the sources accept, and claims about the others.

Permissions bind participants that joined with an identity and a rule. A governance that lets others join, or protects a
topic less than the sources do, weakens every claim. The claims about that are reported only if they do not hold.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise, product

from comarmor.patterns.decision_lists import Block, DecisionList, SearchBudget, Unknown, Witness
from comarmor.patterns.glob import EVERYTHING
from comarmor.patterns.proofs import escapes
from comarmor.patterns.tokens import PatternError
from comarmor.values import Data
from keymint import api
from keymint.errors import Reason
from keymint_ros2_dds.decision.semantics import STANDARD, Semantics, Variation
from keymint_ros2_dds.documents import governance_document
from keymint_ros2_dds.lowering.name_mapping import TopicAction
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.proving.document_lists import is_closed, patterns
from keymint_ros2_dds.reading import signed_governance
from keymint_ros2_dds.reading.signed_governance import ACCESS, JOIN, UNAUTHENTICATED, DocumentDomainRule
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains
from keymint_ros2_dds.settings import settings_of

_domain_access = api.lazy("keymint_ros2_dds.decision.evaluator:DomainAccess")
ACTIONS: tuple[TopicAction, ...] = ("publish", "subscribe")
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

    def __init__(self, content: bytes, place: tuple[str, int], package: api.Package | None) -> None:
        built, self._accepted = b"", False
        if package is not None:
            built, _ = governance_document.build(package, allow_vendor_specific=True)
            self._accepted = settings_of(package).accepts_open
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

    def transparent(self, domains: tuple[api.DomainRange, ...]) -> bool:
        """Tell whether the permissions alone decide, as every implementation reads the document.

        Then it is plain, each domain has a rule, and each rule puts joining and every topic under access control.

        Args:
            domains: the domains of the policy.
        """
        return not self.differs and transparent(self._contents[0], domains)

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
def transparent(content: bytes, domains: tuple[api.DomainRange, ...]) -> bool:
    """Tell whether a governance document leaves it to the permissions; see :meth:`EnclaveGovernance.transparent`."""
    document = signed_governance.read(content)
    if document.quirks or unread_topic(document, STANDARD):
        return False
    rules = document.domain_rules
    closed = all(each.join_controlled and not each.unauthenticated and is_closed(each, STANDARD) for each in rules)
    exact = all(None not in {each.first, each.last} for rule in rules for each in rule.domains)
    wanted = {domain for item in domains for domain in range(item.first, item.last + 1)}
    return closed and exact and all(document.rule(domain) is not None for domain in wanted)


def unread_topic(document: signed_governance.GovernanceDocument, semantics: Semantics) -> str:
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


def cuts(ranges: Iterable[DocumentDomains | api.DomainRange]) -> Iterator[api.DomainRange]:
    """Yield ranges of domains such that each given range contains all or none of the domains of each one."""
    edges = {0, LAST_DOMAIN + 1}
    for domains in ranges:
        first = domains.first or 0
        edges |= {first, first + 1, *(() if domains.last is None else (domains.last + 1,))}
    for begin, end in pairwise(sorted(edge for edge in edges if 0 <= edge <= LAST_DOMAIN + 1)):
        yield api.DomainRange(begin, end - 1)


_CLAIMED = {
    "join": ("every participant", "only subjects with a rule of the policy may join"),
    "protect": (
        "every topic name that the claims on publish and subscribe cover",
        "the sources require stronger protection",
    ),
}
"""What the claims about domains cover, and what the policy expects."""
ACCEPT = "or accept it with <exceptions><open_governance/></exceptions> in profile/keymint_profile.xml"
_QUALITIES = {
    "true": {"protected"},
    "1": {"protected"},
    "SIGN": {"signed"},
    "ENCRYPT": {"signed", "encrypted"},
    "SIGN_WITH_ORIGIN_AUTHENTICATION": {"signed", "origin"},
    "ENCRYPT_WITH_ORIGIN_AUTHENTICATION": {"signed", "encrypted", "origin"},
}
"""The protection that each value gives; other values give none."""


class Weaker(Data):
    """An element that protects less than the sources require.

    Attributes:
        line: line of the rule.
        tag: the element.
        text: its value.
        required: the value in the sources.
        topic: a topic that it protects; empty for the domain.
    """

    line: int
    tag: str
    text: str
    required: str
    topic: str = ""


def help_for(governance: EnclaveGovernance, domain: int) -> str:
    """Return how to fix a governance that leaves a topic or domain open, or refuses access to it."""
    if governance.accepted_rule(domain) is not None:
        return "the sources differ: run 'keymint install' to sign the governance that they build"
    return f"put it under access control in the governance of the package or its defaults, {ACCEPT}"


def governance_claims(
    task: api.ComparisonTask, governance: EnclaveGovernance, variation: Variation
) -> Iterator[api.Claim]:
    """Yield the claims about domains that are refuted or unknown, as an implementation reads the governance."""
    name, place = variation.name, governance.document.place

    def refuted(each: api.DomainRange, action: str, topic: str, reason: str, line: int, help_: str) -> api.Claim:
        universe, expected = _CLAIMED[action]
        endpoint = api.Endpoint(task.rules.subject, action, topic, domain=each.first)
        policy = api.PolicyDecision(allowed=False, where=None, reason=Reason((expected,)))
        verdict = api.Verdict(allowed=True, reason=reason, where=place(line))
        example = api.Counterexample(endpoint, None, policy, verdict, help_, place(line), expected)
        return api.Claim(name, action, (each,), universe, api.Proof.COUNTEREXAMPLE, "", example)

    for domains in cuts(governance.domains()):
        first = domains.first
        rule = _domain_access(governance.document, first, variation.semantics).rule
        if rule is None:
            continue
        own, accepted = governance.source_rule(first), governance.accepted_rule(first)
        where = f" domain {first}" if first else ""
        if not rule.join_controlled and (accepted is None or accepted.join_controlled):
            reason = f"{JOIN} is false: every identity of the authority may join{where}"
            yield refuted(domains, "join", "", reason, rule.line_of(JOIN), help_for(governance, first))
        if rule.unauthenticated and (accepted is None or not accepted.unauthenticated):
            reason = f"{UNAUTHENTICATED} is true: participants without identity and permissions may join{where}"
            yield refuted(domains, "join", "", reason, rule.line_of(UNAUTHENTICATED), help_for(governance, first))
        if own is None or not governance.differs:
            continue
        for found in weaker(rule, own, variation.semantics, SearchBudget(task.states, task.go_on)):
            if isinstance(found, Unknown):
                universe, _ = _CLAIMED["protect"]
                yield api.Claim(name, "protect", (domains,), universe, api.Proof.UNKNOWN, found.reason, spent=True)
            else:
                scope = f"for the topic {found.topic!r}" if found.topic else f"in domain {first}"
                reason = f"{found.tag} is {found.text} {scope}, but the sources require {found.required}"
                help_ = "run 'keymint install' to sign the governance that the sources build"
                yield refuted(domains, "protect", found.topic, reason, found.line, help_)


_CONTROLLED = signed_governance.DocumentTopicRule(
    "*", read_controlled=True, write_controlled=True, protections=("false", "false", "NONE", "NONE"), line=0
)
STRICT = DocumentDomainRule(
    (), join_controlled=True, unauthenticated=False, protections=("NONE",) * 3, topic_rules=(_CONTROLLED,), line=0
)
"""What a domain without sources requires: access control, and no protection."""


def weaker(
    signed: DocumentDomainRule,
    required: DocumentDomainRule,
    semantics: Semantics,
    budget: SearchBudget,
    *,
    access: bool = False,
) -> Iterator[Weaker | Unknown]:
    """Yield each element that protects less than the sources require, with a shortest topic that it covers.

    Args:
        signed: the rule of the document.
        required: the rule of the sources.
        semantics: how documents are read.
        budget: limits of each search.
        access: access control counts as protection, too.

    Raises:
        PatternError: implementations read an expression differently.
    """
    yield from _weaker_domain(signed, required, access=access)
    elements: dict[tuple[int, str], Weaker] = {}
    for (rule, region), (own, wanted) in product(_regions(signed, semantics), _regions(required, semantics)):
        lacking = list(_lacking(signed_governance.TOPIC_PROTECTIONS, rule.protections, own.protections))
        for action, tag in ACCESS.items():
            if access and own.controls(action) and not rule.controls(action):
                lacking.append((tag, "false", "true"))
        if not lacking or all((rule.line, tag) in elements for tag, _, _ in lacking):
            continue
        outcome = escapes((region, wanted), (), octets.universe(pairs=False), budget)
        if isinstance(outcome, Unknown):
            yield outcome
        elif isinstance(outcome, Witness):
            topic = octets.in_text(outcome.word)
            for tag, text, value in lacking:
                elements.setdefault((rule.line, tag), Weaker(rule.line, tag, text, value, topic))
    yield from elements.values()


def _weaker_domain(signed: DocumentDomainRule, required: DocumentDomainRule, *, access: bool) -> Iterator[Weaker]:
    for tag, text, value in _lacking(signed_governance.DOMAIN_PROTECTIONS, signed.protections, required.protections):
        yield Weaker(signed.line_of(tag), tag, text, value)
    if access and required.join_controlled and not signed.join_controlled:
        yield Weaker(signed.line_of(JOIN), JOIN, "false", "true")
    if access and signed.unauthenticated and not required.unauthenticated:
        yield Weaker(signed.line_of(UNAUTHENTICATED), UNAUTHENTICATED, "true", "false")


def _lacking(tags: Sequence[str], texts: Sequence[str], wanted: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield each element whose value protects less than the wanted one, with both values."""
    for tag, text, value in zip(tags, texts, wanted, strict=True):
        if not _QUALITIES.get(value, set()) <= _QUALITIES.get(text, set()):
            yield tag, text, value


def _regions(
    rule: DocumentDomainRule, semantics: Semantics
) -> Iterator[tuple[signed_governance.DocumentTopicRule, DecisionList]]:
    """Yield each topic rule, with the list that permits the topics that it applies to."""
    before: tuple[Block, ...] = ()
    for topic_rule in rule.topic_rules:
        globs = patterns(topic_rule.expression, semantics, pairs=False)
        yield topic_rule, (*before, Block(True, globs))
        before = (*before, Block(False, globs))
        if EVERYTHING in globs:
            return
