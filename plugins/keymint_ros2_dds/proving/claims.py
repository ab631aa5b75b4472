"""The claims about one permissions document."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import pairwise
from types import MappingProxyType

from keymint.api import Claim, Counterexample, DomainRange, PolicyDecision, Proof, Verdict
from keymint.graph import Edge
from keymint.ir import Effect, SubjectRules
from keymint.keymake.glob import GlobError
from keymint.proof import Budget, DecisionList, Outcome, Universe, Unknown, Witness, difference
from keymint_ros2_dds import decision
from keymint_ros2_dds.compiling.lower import Lowered
from keymint_ros2_dds.decision import OMG, VARIATIONS, Decision, Judge, Variation
from keymint_ros2_dds.decision.document import Grant, PermissionsDocument
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.proving import lists, octets, policy

ACTIONS = ("publish", "subscribe")
LAST_DOMAIN = 232
"""The highest domain id whose ports exist for any participant (DDSI-RTPS 2.3, 9.6.1.1)."""
_ALWAYS = (
    "the governance document puts every topic under access control, and its domain rules let the subject join",
    "a grant of the subject, for Cyclone DDS its first one, is valid at the time",
    "ROS names are mapped as the distribution documents it",
    "an endpoint has one partition, whose name is text, and no data tags (of several, each must be permitted)",
    "relay is not asked about",
)
ASSUMPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "omg": ("documents are read as DDS Security 1.1 says (9.4.1.3)", *_ALWAYS),
        "cyclonedds-0.10": (
            "documents are read as Cyclone DDS 0.10.2 was measured to read them; its topic check is part of the model",
            *_ALWAYS,
        ),
        "fastdds-2.9": (
            "documents are read as Fast DDS 2.9.1 was measured to read them",
            "names beyond ASCII are compared as in the C locale, by byte; in others, as Python sets, also by character",
            "participants are in the domains of the policy: local checks do not look at domains",
            "local time is UTC, in which Fast DDS takes the dates of a grant to be",
            *_ALWAYS,
        ),
    }
)


@dataclass(frozen=True, slots=True)
class Held:
    """What a permissions document is held against, and at what cost.

    Attributes:
        subject_name: the identity's, in the order of RFC 2253, e.g. ``CN=/talker,OU=0f``.
        rules: what the policy says of the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the policy holds.
        states: how many states a comparison may visit.
        go_on: asked again and again; a comparison is given up when it returns False.
    """

    subject_name: str
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    states: int
    go_on: Callable[[], bool]


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of a permissions document, signed or not.

    Attributes:
        document: the document.
        held: what it is held against.
        lowered: the rules of that on the level of DDS, from :func:`keymint_ros2_dds.compiling.lower.lower`.
    """

    document: PermissionsDocument
    held: Held
    lowered: Lowered


def prove_document(question: Question, *, models: Sequence[str] | None = None) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        question: what is asked.
        models: names of the models, of :data:`ASSUMPTIONS`; None: all.
    """
    compare = _Comparison(question)
    names = ASSUMPTIONS if models is None else models
    return tuple(claim for name in names for claim in _Model(question, compare, name).claims())


_Claiming = Callable[..., Claim]
_SECOND = timedelta(seconds=1)
_LAST_MOMENT = datetime.max.replace(tzinfo=UTC) - _SECOND
_DATE = "%Y-%m-%dT%H:%M:%S"


@dataclass(frozen=True, slots=True)
class _Era:
    """A time at which a grant is in force; others may follow in which it is, too."""

    grant: Grant
    begin: datetime
    end: datetime


class _Comparison:
    """What a policy says, held against decision lists of the document: once for all models that read it alike."""

    def __init__(self, question: Question) -> None:
        self._question = question
        self.pairs = lists.has_partitions(question.lowered, question.document.grants)
        self._universe = Universe(
            octets.ALPHABET, fields=2 if self.pairs else 1, separator=lists.SEPARATOR, last_nonempty=True
        )
        self._said = {action: lists.of_policy(question.lowered, action, pairs=self.pairs) for action in ACTIONS}
        self._known: dict[tuple[DecisionList, tuple[DecisionList, ...]], Outcome] = {}

    def of(self, action: str, permitted: tuple[DecisionList, ...], *, inside: bool) -> Outcome:
        """Compare what the policy says of an action, inside or outside of its domains, with what is permitted."""
        said = self._said[action] if inside else ()
        key = (said, permitted)
        found = self._known.get(key)
        if found is None:
            budget = Budget(self._question.held.states, self._question.held.go_on)
            found = self._known[key] = difference(said, *permitted, universe=self._universe, budget=budget)
        return found


@cache
def _semantics(name: str) -> Semantics:
    """Return how a model reads documents; put together from its deviations once, and not for every enclave."""
    return VARIATIONS[name].semantics


class _Model:
    """The claims of one model."""

    def __init__(self, question: Question, comparison: _Comparison, name: str) -> None:
        self._question = question
        self._comparison = comparison
        self._variation = VARIATIONS[name]
        self._semantics = _semantics(name)
        self._refused = self._semantics.refuses(question.document)
        self._untold = "" if self._refused else self._semantics.untold(question.document)
        self._eras = () if self._refused else tuple(_eras(question, self._semantics))
        grants = [era.grant for era in self._eras]
        about = (question.document, grants, question.held.rules, self._semantics)
        self._untold = self._untold or octets.ambiguous(*about)
        self._by_locale = octets.by_locale(*about)

    def claims(self) -> Iterator[Claim]:
        groups = tuple(self._domains())
        for action in ACTIONS:
            for domains, inside in groups:
                claim = self._claim(action, domains, inside=inside)
                # That nothing is permitted where the policy does not hold is said only where it is wrong.
                if inside or claim.proof is not Proof.PROVEN:
                    yield claim

    def _domains(self) -> Iterator[tuple[tuple[DomainRange, ...], bool]]:
        """Yield groups of domains in which policy and document are the same, and whether the policy holds there."""
        wanted = self._question.held.domains
        grants = [era.grant for era in self._eras]
        rules = [rule for grant in grants for rule in self._semantics.rules(grant)]
        edges = {0, *(d.first for d in wanted), *(d.last + 1 for d in wanted)}
        for each in (each for rule in rules for each in rule.domains):
            first = each.first or 0
            edges |= {first, first + 1, *(() if each.last is None else (each.last + 1,))}
        cuts = [*sorted(edge for edge in edges if 0 <= edge <= LAST_DOMAIN), LAST_DOMAIN + 1]
        permits_more = self._semantics.default_counts and any(grant.allows for grant in grants)
        groups: dict[tuple[bool, ...], list[DomainRange]] = {}
        for first, following in pairwise(cuts):
            inside = any(d.first <= first <= d.last for d in wanted)
            held = [lists.holds(rule, first, self._semantics) for rule in rules]
            # Where neither policy nor document says anything there is nothing to compare.
            if inside or (self._semantics.domains_count and (permits_more or any(held))):
                groups.setdefault((inside, *held), []).append(DomainRange(first, following - 1))
        for kind, domains in groups.items():
            yield tuple(_joined(domains)), kind[0]

    def _claim(self, action: str, domains: tuple[DomainRange, ...], *, inside: bool) -> Claim:
        pairs = self._comparison.pairs
        universe = octets.PAIRS if pairs else octets.TOPICS

        def claim(
            proof: Proof, reason: str = "", counterexample: Counterexample | None = None, *, spent: bool = False
        ) -> Claim:
            return Claim(self._variation.name, action, domains, universe, proof, reason, counterexample, spent)

        if self._untold:
            return claim(Proof.UNKNOWN, self._untold)
        domain = domains[0].first
        try:
            found = [(era, self._compare(era, action, domain, inside=inside)) for era in self._eras or (None,)]
        except GlobError as error:
            return claim(Proof.UNKNOWN, f"{self._question.document.file}: {error}")
        witnesses = [(era, outcome) for era, outcome in found if isinstance(outcome, Witness)]
        if witnesses:
            era, witness = min(witnesses, key=lambda each: len(each[1].word))
            return self._refuted(claim, action, domain, era, witness, inside=inside)
        unknown = next((outcome for _, outcome in found if isinstance(outcome, Unknown)), None)
        if unknown:
            return claim(Proof.UNKNOWN, unknown.reason, spent=True)
        return claim(Proof.UNKNOWN, self._by_locale) if self._by_locale else claim(Proof.PROVEN)

    def _compare(self, era: _Era | None, action: str, domain: int, *, inside: bool) -> Outcome:
        """Compare what the policy says with what is permitted while a grant is in force, or where none ever is."""
        pairs = self._comparison.pairs
        permitted: tuple[DecisionList, ...] = ((),)
        if era is not None:
            permitted = lists.of_grant(era.grant, domain, action, self._semantics, pairs=pairs)
        return self._comparison.of(action, permitted, inside=inside)

    def _refuted(
        self, claim: _Claiming, action: str, domain: int, era: _Era | None, witness: Witness, *, inside: bool
    ) -> Claim:
        found = self._counterexample(action, domain, era, witness.word, inside=inside)
        if found.policy.allowed is not witness.left or found.document.allowed is witness.left:
            name = found.endpoint.object.name
            return claim(
                Proof.UNKNOWN, f"the engine and the plain evaluators disagree on {name!r}: a defect of Keymint"
            )
        return claim(Proof.COUNTEREXAMPLE, "", found)

    def _counterexample(self, action: str, domain: int, era: _Era | None, word: str, *, inside: bool) -> Counterexample:
        asked = self._question.held
        pair = word.split(lists.SEPARATOR) if self._comparison.pairs else ("", word)
        partition, topic = map(octets.in_text, pair)
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
            next((edge for edge in edges[1:] if policy.is_ros_name(edge.object.name)), None),
            said,
            self._verdict(action, domain, era, topic, partition),
        )

    def _verdict(self, action: str, domain: int, era: _Era | None, topic: str, partition: str) -> Verdict:
        """Return what the decision point says, read by this model."""
        question = self._question
        if self._refused:
            return Verdict(allowed=False, reason=self._refused)
        if era is None:
            return self._never()
        now = era.begin

        def ask(variation: Variation) -> Decision:
            judge = Judge(question.document, question.held.subject_name, now, domain, variation)
            return judge.decide(action, topic, (partition,) if partition else ())

        found = ask(self._variation)
        deviation = ""
        if self._variation.name != OMG.name and ask(OMG).allowed is not found.allowed:
            deviation = "; ".join(map(str, decision.explain(lambda asked: ask(asked).allowed, self._variation)))
        reason = found.reason
        if len(self._eras) > 1:
            reason += f" (by the grant in force from {era.begin:{_DATE}} to {era.end:{_DATE}})"
        return Verdict(found.allowed, reason, found.line, deviation)

    def _never(self) -> Verdict:
        """Return why no grant is ever in force."""
        document, name = self._question.document, self._question.held.subject_name
        grant = next(iter(self._semantics.grants(document, name)), None)
        if grant is None:
            return Verdict(allowed=False, reason=f"{document.file}: no grant is about {name!r}")
        dates = f"{grant.not_before.strip()} to {grant.not_after.strip()}"
        reason = f"{document.place(grant.line)}: the grant of {name!r} is never valid ({dates})"
        return Verdict(allowed=False, reason=reason, line=grant.line)


def _eras(question: Question, semantics: Semantics) -> Iterator[_Era]:
    """Yield a time at which each grant that is about the identity is in force; grants that never are have none."""
    grants = semantics.grants(question.document, question.held.subject_name)
    if not semantics.passes_over_invalid:
        grants = grants[:1]
    if len(grants) == 1:
        if (only := semantics.period(grants[0])) is not None:
            yield _Era(grants[0], *only)
        return
    periods = [(grant, period) for grant in grants if (period := semantics.period(grant)) is not None]
    cuts = sorted({begin for _, (begin, _) in periods} | {_next(end) for _, (_, end) in periods})
    known = set()
    for begin, following in pairwise(cuts):
        at = next((n for n, (_, (first, last)) in enumerate(periods) if first <= begin <= last), None)
        if at is not None and at not in known:
            known.add(at)
            yield _Era(periods[at][0], begin, following - _SECOND)


def _next(moment: datetime) -> datetime:
    return moment + _SECOND if moment < _LAST_MOMENT else moment


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
