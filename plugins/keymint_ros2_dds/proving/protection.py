# SPDX-License-Identifier: Apache-2.0
"""Refute claims about domains: who may join, and how topics are protected.

Permissions bind participants that joined with an identity and a rule. A governance that lets others join, or protects a
topic less than the sources do, weakens every claim. These claims are reported only if they do not hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

from comarmor.errors import Origin, Reason
from comarmor.patterns.decision_lists import Block, DecisionList, SearchBudget, Unknown, Witness
from comarmor.patterns.glob import EVERYTHING
from comarmor.patterns.proofs import escapes
from comarmor.values import dataclass
from keymint.api import Claim, Counterexample, DomainRange, Endpoint, PolicyDecision, Proof, Verdict
from keymint_ros2_dds.decision.endpoint_access import DomainAccess
from keymint_ros2_dds.decision.semantics import Semantics, Variation
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance, cuts
from keymint_ros2_dds.proving.governance_lists import patterns
from keymint_ros2_dds.proving.questions import ProofQuestion
from keymint_ros2_dds.reading.signed_governance import (
    ACCESS,
    DOMAIN_PROTECTIONS,
    JOIN,
    TOPIC_PROTECTIONS,
    UNAUTHENTICATED,
    DocumentDomainRule,
    DocumentTopicRule,
)

_CLAIMED = {
    "join": ("every participant", "only subjects with a rule of the policy may join"),
    "protect": (
        "every topic name that the claims on publish and subscribe cover",
        "the sources require stronger protection",
    ),
}
"""What the claims about domains cover, and what the policy expects."""
ACCEPT = "or accept it with <accept><open_governance/></accept> in profile/keymint_profile.xml"
_QUALITIES = {
    "true": {"protected"},
    "1": {"protected"},
    "SIGN": {"signed"},
    "ENCRYPT": {"signed", "encrypted"},
    "SIGN_WITH_ORIGIN_AUTHENTICATION": {"signed", "origin"},
    "ENCRYPT_WITH_ORIGIN_AUTHENTICATION": {"signed", "encrypted", "origin"},
}
"""The protection that each value gives; other values give none."""


@dataclass(frozen=True, slots=True)
class Weaker:
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


def claims(question: ProofQuestion, governance: EnclaveGovernance, variation: Variation) -> Iterator[Claim]:
    """Yield the claims about domains that are refuted or unknown, as an implementation reads the governance."""
    for domains in cuts(governance.domains()):
        first = domains.first
        rule = DomainAccess(governance.document, first, variation.semantics).rule
        if rule is None:
            continue
        place, refuted = governance.document.place, partial(_refuted, question, variation, domains)
        own, accepted = governance.source_rule(first), governance.accepted_rule(first)
        where = f" domain {first}" if first else ""
        if not rule.join_controlled and (accepted is None or accepted.join_controlled):
            reason = f"{JOIN} is false: every identity of the authority may join{where}"
            yield refuted("join", "", reason, place(rule.line_of(JOIN)), help_for(governance, first))
        if rule.unauthenticated and (accepted is None or not accepted.unauthenticated):
            reason = f"{UNAUTHENTICATED} is true: participants without identity and permissions may join{where}"
            yield refuted("join", "", reason, place(rule.line_of(UNAUTHENTICATED)), help_for(governance, first))
        if own is None or not governance.differs:
            continue
        for found in weaker(rule, own, variation.semantics, question.budget()):
            if isinstance(found, Unknown):
                universe, _ = _CLAIMED["protect"]
                yield Claim(variation.name, "protect", (domains,), universe, Proof.UNKNOWN, found.reason, spent=True)
            else:
                scope = f"for the topic {found.topic!r}" if found.topic else f"in domain {first}"
                reason = f"{found.tag} is {found.text} {scope}, but the sources require {found.required}"
                help_ = "run 'keymint install' to sign the governance that the sources build"
                yield refuted("protect", found.topic, reason, place(found.line), help_)


def _refuted(
    question: ProofQuestion, variation: Variation, domains: DomainRange,
    action: str, topic: str, reason: str, where: Origin, help_: str,
) -> Claim:  # fmt: skip
    universe, expected = _CLAIMED[action]
    example = Counterexample(
        Endpoint(question.task.rules.subject, action, topic, domain=domains.first),
        None,
        PolicyDecision(allowed=False, where=None, reason=Reason((expected,))),
        Verdict(allowed=True, reason=reason, where=where),
        help_,
        where,
        expected,
    )
    return Claim(variation.name, action, (domains,), universe, Proof.COUNTEREXAMPLE, "", example)


STRICT = DocumentDomainRule(
    (),
    join_controlled=True,
    unauthenticated=False,
    protections=("NONE",) * len(DOMAIN_PROTECTIONS),
    topic_rules=(
        DocumentTopicRule(
            "*", read_controlled=True, write_controlled=True, protections=("false", "false", "NONE", "NONE"), line=0
        ),
    ),
    line=0,
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
        lacking = list(_weaker_topics(rule, own, access=access))
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
    for tag, text, value in _lacking(DOMAIN_PROTECTIONS, signed.protections, required.protections):
        yield Weaker(signed.line_of(tag), tag, text, value)
    if access and required.join_controlled and not signed.join_controlled:
        yield Weaker(signed.line_of(JOIN), JOIN, "false", "true")
    if access and signed.unauthenticated and not required.unauthenticated:
        yield Weaker(signed.line_of(UNAUTHENTICATED), UNAUTHENTICATED, "true", "false")


def _weaker_topics(rule: DocumentTopicRule, own: DocumentTopicRule, *, access: bool) -> Iterator[tuple[str, str, str]]:
    """Yield each element in which a topic rule is weaker than another, with both values."""
    yield from _lacking(TOPIC_PROTECTIONS, rule.protections, own.protections)
    for action, tag in ACCESS.items():
        if access and own.controls(action) and not rule.controls(action):
            yield tag, "false", "true"


def _lacking(tags: Sequence[str], texts: Sequence[str], wanted: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield each element whose value protects less than the wanted one, with both values."""
    for tag, text, value in zip(tags, texts, wanted, strict=True):
        if not _QUALITIES.get(value, set()) <= _QUALITIES.get(text, set()):
            yield tag, text, value


def _regions(rule: DocumentDomainRule, semantics: Semantics) -> Iterator[tuple[DocumentTopicRule, DecisionList]]:
    """Yield each topic rule, with the list that permits the topics that it applies to."""
    before: tuple[Block, ...] = ()
    for topic_rule in rule.topic_rules:
        globs = patterns(topic_rule.expression, semantics, pairs=False)
        yield topic_rule, (*before, Block(True, globs))
        before = (*before, Block(False, globs))
        if EVERYTHING in globs:
            return
