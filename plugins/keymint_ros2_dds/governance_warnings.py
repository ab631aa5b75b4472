"""What the sources of a governance leave open: found at build, at the rule that says so.

Where a rule of the governance puts no access control on a topic, every vendor lets every participant have it, whatever
the policy says. That may be meant; then the profile says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.decision_lists import Block, DecisionList, Equal, SearchBudget, Universe
from comarmor.patterns.glob import EVERYTHING, Glob, normalise
from comarmor.patterns.proofs import escapes
from comarmor.patterns.relations import union_covers
from keymint.api import DomainRange, DomainRule, Package, TopicProtection
from keymint_ros2_dds.documents import governance_document
from keymint_ros2_dds.domains import in_words
from keymint_ros2_dds.lowering.lower import Lowered, lower
from keymint_ros2_dds.proving import octets, permission_lists
from keymint_ros2_dds.proving.protection import ACCEPT
from keymint_ros2_dds.reading.signed_governance import ACCESS, JOIN, UNAUTHENTICATED

STATES = 20_000
"""States that a question may visit; what is given up counts as open."""
_PAIRS = Universe(octets.ALPHABET, fields=2, separator=permission_lists.SEPARATOR, last_nonempty=True)
_NONE = "NONE"
UNPROTECTED = "governance-unprotected"
"""Code of the finding on topics that are neither signed nor encrypted: an owner may trust the network."""


def findings(package: Package, lowered: Lowered | None = None) -> tuple[Diagnostic, ...]:
    """Return what the governance of a package leaves open although its policy does not allow it.

    A finding names no subject, since many packages have the same governance. What the profile accepts is a note.

    Args:
        package: the package.
        lowered: the rules of the package on the level of DDS, where they are known.

    Raises:
        KeymintError: a rule of the policy, or an expression of the governance, cannot be mapped.
    """
    accepted = package.governance.accepts_open
    severity = Severity.NOTE if accepted else Severity.WARNING
    help_ = "the profile accepts it" if accepted else f"put it under access control, {ACCEPT}"
    found: list[Diagnostic] = []
    seen: list[DomainRange] = []
    for rule in package.governance.domain_rules:
        domains = tuple(_left(rule.domains, seen))
        seen += rule.domains
        if domains:
            said = (*_of_domain(rule, domains), *_of_topics(package, rule, domains, lowered))
            found += (Diagnostic(code, severity, text, where, help_) for code, text, where in said)
    return tuple(dict.fromkeys(found))


_Said = tuple[str, str, Origin]
"""Code, message and place of a finding."""


def _left(domains: tuple[DomainRange, ...], seen: list[DomainRange]) -> Iterator[DomainRange]:
    """Yield the domains that no rule before was about: the first rule counts."""
    edges = {edge for each in (*domains, *seen) for edge in (each.first, each.last + 1)}
    for first, following in pairwise(sorted(edges)):
        inside = any(each.first <= first <= each.last for each in domains)
        if inside and not any(each.first <= first <= each.last for each in seen):
            yield DomainRange(first, following - 1)


def _of_domain(rule: DomainRule, domains: tuple[DomainRange, ...]) -> Iterator[_Said]:
    where = in_words(domains)
    if not rule.enable_join_access_control:
        text = f"{JOIN} is false: every identity of the authority may join {where}, also without any permission"
        yield "governance-open-join", text, rule.origin
    if rule.allow_unauthenticated_participants:
        text = f"{UNAUTHENTICATED} is true: participants without identity and permissions may join {where}"
        yield "governance-open-join", text, rule.origin


def _of_topics(
    package: Package, rule: DomainRule, domains: tuple[DomainRange, ...], lowered: Lowered | None
) -> Iterator[_Said]:
    inside = any(a.first <= b.last and b.first <= a.last for a in domains for b in package.permissions.domains)
    before: list[Glob] = []
    for topic in rule.topic_rules:
        own = [
            each
            for each in governance_document.patterns(topic, package.distro)
            if not union_covers(tuple(before), each)
        ]
        open_ = [] if not own else [action for action in ACCESS if not _controls(topic, action)]
        if open_ and inside and lowered is None:
            lowered = lower(package.permissions.rules, package.distro)
        for action in open_:
            if inside and lowered is not None and _allowed(lowered, action, tuple(before), tuple(own)):
                continue
            text = (
                f"{ACCESS[action]} is false for {topic.expression!r}: every participant may {action} what it matches "
                f"in {in_words(domains)}, also what the policy denies or does not allow"
            )
            yield "governance-open", text, topic.origin
        kinds = (rule.rtps_protection_kind, topic.metadata_protection_kind, topic.data_protection_kind)
        if own and set(kinds) == {_NONE}:
            text = (
                f"nothing protects what {topic.expression!r} matches in {in_words(domains)} (rtps_, metadata_ and "
                "data_protection_kind are NONE): whoever reaches the network can read and forge it"
            )
            yield UNPROTECTED, text, topic.origin
        before += own


def _controls(topic: TopicProtection, action: str) -> bool:
    return topic.enable_write_access_control if action == "publish" else topic.enable_read_access_control


def _allowed(lowered: Lowered, action: str, before: tuple[Glob, ...], own: tuple[Glob, ...]) -> bool:
    """Tell whether a policy allows all that a rule leaves open: those topics, in every partition."""
    opened: DecisionList = tuple(
        Block(
            allows,
            tuple(normalise((*EVERYTHING, permission_lists.SEPARATOR, *octets.of_glob(topic))) for topic in topics),
        )
        for allows, topics in ((False, before), (True, own))
    )
    said = permission_lists.of_policy(lowered, action, pairs=True)
    return isinstance(escapes((opened,), said, _PAIRS, SearchBudget(STATES)), Equal)
