"""The claims about one enclave."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from types import MappingProxyType

from keymint.api import Claim, Counterexample, DomainRange, Obligation, PolicyDecision, Proof, Verdict
from keymint.errors import KeymintError, Origin
from keymint.graph import Edge
from keymint.ir import Effect, SubjectRules
from keymint.keymake.glob import GlobError, charset
from keymint.proof import Budget, DecisionList, Equal, Outcome, Universe, Unknown, difference
from keymint_ros2_dds import decision
from keymint_ros2_dds.build import PERMISSIONS_XML
from keymint_ros2_dds.decision import OMG, VARIATIONS, Decision, Judge, Variation
from keymint_ros2_dds.decision.document import Grant, PermissionsDocument
from keymint_ros2_dds.install import CA, CERTIFICATE, PERMISSIONS_CA, PERMISSIONS_P7S
from keymint_ros2_dds.lower import Lowered, lower
from keymint_ros2_dds.proving import lists, policy, signed
from keymint_ros2_dds.transports.files import subject_name

ACTIONS = ("publish", "subscribe")
LAST_DOMAIN = 232
"""The highest domain id whose ports exist for any participant (DDSI-RTPS 2.3, 9.6.1.1)."""
ALPHABET = charset([(0x20, 0x5B), (0x5D, 0x7E)])
"""Printable ASCII without the backslash, which is an escape for the standard and a character for Cyclone and Fast DDS:
no expression about a name that has one is read alike."""
TOPICS = (
    "every topic name of printable ASCII without a backslash, in the default partition; nothing is permitted outside "
    "of it"
)
PAIRS = "every pair of a partition and a topic name of printable ASCII without a backslash"

_ALWAYS = (
    "the governance document puts every topic under access control, and its domain rules let the subject join",
    "the grant is valid at the time, and ROS names are mapped as the distribution documents it",
    "an endpoint has one partition, whose name is text, and no data tags (of several, each must be permitted)",
    "relay is not asked about",
)
ASSUMPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "omg": ("documents are read as DDS Security 1.1 says (9.4.1.3)", *_ALWAYS),
        "cyclonedds-0.10": (
            "documents are read as Cyclone DDS 0.10 was measured to read them; its topic check is part of the model",
            *_ALWAYS,
        ),
        "fastdds-2.9": (
            "documents are read as Fast DDS 2.9 was measured to read them",
            "participants are in the domains of the policy: local checks do not look at domains",
            *_ALWAYS,
        ),
    }
)


def prove(obligation: Obligation) -> tuple[Claim, ...]:
    """Return the claims about an enclave, by model, action and domains.

    Raises:
        KeymintError: a file of the enclave is missing or cannot be read, a signature does not hold, or a rule of the
            policy cannot be mapped.
    """
    enclave = _Enclave.of(obligation)
    return tuple(claim for name in ASSUMPTIONS for claim in _Model(enclave, VARIATIONS[name]).claims())


@dataclass(frozen=True, slots=True)
class _Enclave:
    """What the claims of all models are about."""

    asked: Obligation
    document: PermissionsDocument
    subject_name: str
    lowered: Lowered
    pairs: bool
    policies: Mapping[str, DecisionList]
    known: dict[tuple[DecisionList, tuple[DecisionList, ...]], Outcome]

    @classmethod
    def of(cls, asked: Obligation) -> _Enclave:
        authority = _file(asked, PERMISSIONS_CA if PERMISSIONS_CA in asked.files else CA)
        where = Origin(f"{asked.folder}/{PERMISSIONS_P7S}")
        content = signed.content(_file(asked, PERMISSIONS_P7S), authority, where)
        same = asked.files.get(PERMISSIONS_XML) == content
        document = decision.read(content, f"{asked.folder}/{PERMISSIONS_XML if same else PERMISSIONS_P7S}")
        name = subject_name(_file(asked, CERTIFICATE), Origin(f"{asked.folder}/{CERTIFICATE}"))
        lowered = lower(asked.rules, asked.distro)
        pairs = lists.has_partitions(lowered, document.grants)
        policies = {action: lists.of_policy(lowered, action, pairs=pairs) for action in ACTIONS}
        return cls(asked, document, name, lowered, pairs, policies, {})

    @property
    def universe(self) -> Universe:
        return Universe(ALPHABET, fields=2 if self.pairs else 1, separator=lists.SEPARATOR)

    def compare(self, said: DecisionList, permitted: tuple[DecisionList, ...]) -> Outcome:
        """Compare, once for all models that read the document alike."""
        key = (said, permitted)
        if key not in self.known:
            budget = Budget(self.asked.states, self.asked.go_on)
            self.known[key] = difference(said, *permitted, universe=self.universe, budget=budget)
        return self.known[key]


def _file(asked: Obligation, name: str) -> bytes:
    content = asked.files.get(name)
    if content is None:
        raise KeymintError(
            "is missing", where=Origin(f"{asked.folder}/{name}"), help="run 'keymint install'", code="file-missing"
        )
    return content


class _Model:
    """The claims of one model."""

    def __init__(self, enclave: _Enclave, variation: Variation) -> None:
        self._enclave = enclave
        self._variation = variation
        self._semantics = variation.semantics
        self._refused = self._semantics.refuses(enclave.document)
        self._grant, self._now = self._chosen()

    def _chosen(self) -> tuple[Grant | None, datetime | None]:
        """Return the grant that is about the identity, and a time at which it is valid."""
        if self._refused:
            return None, None
        for grant in self._enclave.document.grants:
            name = grant.subject_name.strip() if self._semantics.trims else grant.subject_name
            begin, end = self._semantics.date(grant.not_before), self._semantics.date(grant.not_after)
            valid = begin is not None and end is not None and begin <= end
            if self._semantics.selects(name, self._enclave.subject_name):
                if valid and begin is not None:
                    return grant, begin
                if not self._semantics.passes_over_invalid:
                    return None, None
        return None, None

    def claims(self) -> Iterator[Claim]:
        for action in ACTIONS:
            for domains, inside in self._domains():
                claim = self._claim(action, domains, inside=inside)
                # That nothing is permitted where the policy does not hold is said only where it is wrong.
                if inside or claim.proof is not Proof.PROVEN:
                    yield claim

    def _domains(self) -> Iterator[tuple[tuple[DomainRange, ...], bool]]:
        """Yield groups of domains in which policy and document are the same, and whether the policy holds there."""
        wanted = self._enclave.asked.domains
        rules = self._grant.rules if self._grant else ()
        edges = {0, *(d.first for d in wanted), *(d.last + 1 for d in wanted)}
        for each in (each for rule in rules for each in rule.domains):
            first = each.first or 0
            edges |= {first, first + 1, *(() if each.last is None else (each.last + 1,))}
        cuts = [*sorted(edge for edge in edges if 0 <= edge <= LAST_DOMAIN), LAST_DOMAIN + 1]
        groups: dict[tuple[bool, ...], list[DomainRange]] = {}
        for first, following in pairwise(cuts):
            inside = any(d.first <= first <= d.last for d in wanted)
            if inside or self._semantics.domains_count:
                kind = (inside, *(lists.holds(rule, first, self._semantics) for rule in rules))
                groups.setdefault(kind, []).append(DomainRange(first, following - 1))
        for kind, domains in groups.items():
            yield tuple(_joined(domains)), kind[0]

    def _claim(self, action: str, domains: tuple[DomainRange, ...], *, inside: bool) -> Claim:
        enclave = self._enclave
        universe = PAIRS if enclave.pairs else TOPICS

        def claim(proof: Proof, reason: str = "", counterexample: Counterexample | None = None) -> Claim:
            return Claim(self._variation.name, action, domains, universe, proof, reason, counterexample)

        said = enclave.policies[action] if inside else ()
        domain = domains[0].first
        try:
            permitted = (
                lists.of_grant(self._grant, domain, action, self._semantics, pairs=enclave.pairs)
                if self._grant
                else ((),)
            )
        except GlobError as error:
            return claim(Proof.UNKNOWN, f"{enclave.document.file}: {error}")
        outcome = enclave.compare(said, permitted)
        if isinstance(outcome, Equal):
            return claim(Proof.PROVEN)
        if isinstance(outcome, Unknown):
            return claim(Proof.UNKNOWN, outcome.reason)
        found = self._counterexample(action, domain, outcome.word, inside=inside)
        if found.policy.allowed is not outcome.left or found.document.allowed is outcome.left:
            name = found.endpoint.object.name
            return claim(
                Proof.UNKNOWN, f"the engine and the plain evaluators disagree on {name!r}: a defect of Keymint"
            )
        return claim(Proof.COUNTEREXAMPLE, "", found)

    def _counterexample(self, action: str, domain: int, word: str, *, inside: bool) -> Counterexample:
        asked = self._enclave.asked
        partition, topic = word.split(lists.SEPARATOR) if self._enclave.pairs else ("", word)
        rules = asked.rules if inside else SubjectRules(asked.rules.subject, ())
        edges = policy.endpoint_edges(rules.subject, asked.distro, action, topic, partition)
        rule = policy.decide(rules, asked.distro, action, topic, partition)
        if rule is not None:
            verb = "allows" if rule.effect is Effect.ALLOW else "denies"
            said = PolicyDecision(
                rule.effect is Effect.ALLOW, rule.origin, f"the {rule.kind} rule {verb} it", rule.audit
            )
        else:
            said = PolicyDecision(allowed=False, where=None, reason="no rule allows it" if inside else "not its domain")
        return Counterexample(
            Edge(rules.subject, action, edges[0].object, domain),
            edges[1] if len(edges) > 1 else None,
            said,
            self._verdict(action, domain, topic, partition),
        )

    def _verdict(self, action: str, domain: int, topic: str, partition: str) -> Verdict:
        """Return what the decision point says, read by this model."""
        enclave = self._enclave
        if self._refused:
            return Verdict(allowed=False, reason=self._refused)
        if (now := self._now) is None:
            return Verdict(allowed=False, reason=f"no valid grant is about {enclave.subject_name!r}")

        def ask(variation: Variation) -> Decision:
            judge = Judge(enclave.document, enclave.subject_name, now, domain, variation)
            return judge.decide(action, topic, (partition,) if partition else ())

        found = ask(self._variation)
        deviation = ""
        if self._variation.name != OMG.name and ask(OMG).allowed is not found.allowed:
            deviation = "; ".join(map(str, decision.explain(lambda asked: ask(asked).allowed, self._variation)))
        return Verdict(found.allowed, found.reason, found.line, deviation)


def _joined(domains: Sequence[DomainRange]) -> Iterator[DomainRange]:
    """Yield ranges of domains, neighbours as one."""
    first, last = domains[0].first, domains[0].last
    for each in domains[1:]:
        if each.first == last + 1:
            last = each.last
        else:
            yield DomainRange(first, last)
            first, last = each.first, each.last
    yield DomainRange(first, last)
