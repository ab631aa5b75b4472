# SPDX-License-Identifier: Apache-2.0
"""Warns at build of topics and domains that the governance leaves open, at the rule that does so.

Where a governance rule puts no access control on a topic, every vendor admits every participant, whatever the policy
says. If that is intended, the profile can accept it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.patterns.decision_lists import Block, DecisionList, Equal, SearchBudget
from comarmor.patterns.glob import EVERYTHING, Glob
from comarmor.patterns.proofs import escapes
from comarmor.patterns.relations import union_covers
from keymint.api import DomainRange, Package
from keymint.errors import Diagnostic, Origin, Severity
from keymint_ros2_dds.documents import governance_document
from keymint_ros2_dds.domains import in_words, uncovered_domains
from keymint_ros2_dds.lowering.lowered_rules import Lowered, lower
from keymint_ros2_dds.lowering.name_mapping import TopicAction
from keymint_ros2_dds.proving import document_lists, octets
from keymint_ros2_dds.proving.enclave_governance import ACCEPT, ACTIONS, cuts
from keymint_ros2_dds.reading.signed_governance import ACCESS, JOIN, UNAUTHENTICATED
from keymint_ros2_dds.settings import DomainRule, TopicProtection, settings_of

STATES = 20_000
"""States that a search may visit; topics that are not decided count as open."""
OPEN_JOIN = "governance-open-join"
UNPROTECTED = "governance-unprotected"
"""Code of the finding on topics that are neither signed nor encrypted; a user may trust the network."""


def findings(package: Package, lowered: Lowered | None = None) -> tuple[Diagnostic, ...]:
    """Return findings on what the governance of a package leaves open and its policy does not allow.

    A finding has no subject, since many packages share a governance. It is a note if the profile accepts it.

    Args:
        package: the package.
        lowered: the rules of the package as DDS patterns, if they are known.

    Raises:
        KeymintError: a rule of the policy, or an expression of the governance, is invalid.
    """
    governance = settings_of(package)
    if all(map(_is_closed, governance.domain_rules)):
        return ()
    accepted = governance.accepts_open
    severity = Severity.NOTE if accepted else Severity.WARNING
    help_ = "the profile accepts it" if accepted else f"put it under access control, {ACCEPT}"
    diagnostics: list[Diagnostic] = []
    earlier: list[DomainRange] = []
    for rule in governance.domain_rules:
        pieces = [each for each in cuts((*rule.domains, *earlier)) if not uncovered_domains([each], rule.domains)]
        domains = uncovered_domains(pieces, earlier)  # the first rule for a domain counts
        earlier += rule.domains
        if domains:
            joining, others = rule.enable_join_access_control, rule.allow_unauthenticated_participants
            texts = open_domain(domains, join_controlled=joining, unauthenticated=others)
            opened = ((OPEN_JOIN, text, rule.origin) for text in texts)
            results = (*opened, *_open_topics(package, rule, domains, lowered))
            diagnostics += (Diagnostic(code, severity, text, where, help_) for code, text, where in results)
    return tuple(dict.fromkeys(diagnostics))


_Finding = tuple[str, str, Origin]
"""Code, message and place of a finding."""


def _is_closed(rule: DomainRule) -> bool:
    """Tell whether nothing in a rule can leave anything open."""
    return (
        rule.enable_join_access_control
        and not rule.allow_unauthenticated_participants
        and all(getattr(topic, tag) for topic in rule.topic_rules for tag in ACCESS.values())
        and not any(_is_unprotected(rule, topic) for topic in rule.topic_rules)
    )


def open_domain(domains: Sequence[DomainRange], *, join_controlled: bool, unauthenticated: bool) -> Iterator[str]:
    """Yield why participants may join domains that no policy allows them, for the code :data:`OPEN_JOIN`."""
    where = in_words(domains)
    if not join_controlled:
        yield f"{JOIN} is false: every identity of the authority may join {where}, even without permissions"
    if unauthenticated:
        yield f"{UNAUTHENTICATED} is true: participants without identity and permissions may join {where}"


def _open_topics(
    package: Package, rule: DomainRule, domains: tuple[DomainRange, ...], lowered: Lowered | None
) -> Iterator[_Finding]:
    inside = any(a.first <= b.last and b.first <= a.last for a in domains for b in package.grant.domains)
    earlier: list[Glob] = []
    for topic in rule.topic_rules:
        patterns = governance_document.patterns(topic, package.distro)
        effective = [pattern for pattern in patterns if not union_covers(tuple(earlier), pattern)]
        if not effective:
            continue
        open_ = [action for action in ACTIONS if not getattr(topic, ACCESS[action])]
        if open_ and inside and lowered is None:
            lowered = lower(package.grant.rules, package.distro)
        for action in open_:
            if inside and lowered is not None and _allowed(lowered, action, tuple(earlier), tuple(effective)):
                continue
            text = (
                f"{ACCESS[action]} is false for {topic.expression!r}: every participant may {action} all matching "
                f"topics in {in_words(domains)}, also those that the policy does not allow"
            )
            yield "governance-open", text, topic.origin
        if _is_unprotected(rule, topic):
            text = (
                f"nothing protects what {topic.expression!r} matches in {in_words(domains)} (rtps_, metadata_ and "
                "data_protection_kind are NONE): whoever reaches the network can read and forge it"
            )
            yield UNPROTECTED, text, topic.origin
        earlier += effective


def _is_unprotected(rule: DomainRule, topic: TopicProtection) -> bool:
    return {rule.rtps_protection_kind, topic.metadata_protection_kind, topic.data_protection_kind} == {"NONE"}


def _allowed(lowered: Lowered, action: TopicAction, earlier: tuple[Glob, ...], patterns: tuple[Glob, ...]) -> bool:
    """Tell whether a policy allows all topics that a rule leaves open, in every partition."""
    opened: DecisionList = tuple(
        Block(allows, tuple(octets.pair(EVERYTHING, octets.of_glob(topic)) for topic in topics))
        for allows, topics in ((False, earlier), (True, patterns))
    )
    policy = document_lists.of_policy(lowered, action, pairs=True)
    return isinstance(escapes((opened,), policy, octets.universe(pairs=True), SearchBudget(STATES)), Equal)
