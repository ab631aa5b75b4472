# SPDX-License-Identifier: Apache-2.0
"""Compares decisions on random governance documents, permissions and policies.

For each document and domain, every name of a small set is decided by brute force (implemented here independently), by
the models, by the real access-control plugin of Cyclone DDS, and for a few documents by participants of Fast DDS. The
claims must agree: if one is proven, document and policy are the same for every name, and every counterexample is real.
"""

from __future__ import annotations

import fnmatch
import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.sax.saxutils import escape

from cryptography.hazmat.primitives import serialization
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator, DomainAccess
from keymint_ros2_dds.decision.semantics import VARIATIONS
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.proving.claims import prove_document
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance
from keymint_ros2_dds.proving.questions import ProofQuestion
from keymint_ros2_dds.reading import signed_governance, signed_permissions
from keymint_ros2_dds.transports.enclave_files import subject_name
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.api import Claim, ComparisonTask, DomainRange, Proof
from keymint.host.vendor_process import ProcessFailedError
from keymint.ir import Rule, SubjectRules

from .handmade import Authorities, access_control
from .model_agreement import RDNS

MODELS = ("omg", "cyclonedds-0.10", "fastdds-2.9")
ACTIONS = ("publish", "subscribe")
NAMES = ("rt/a", "rt/b", "rt/ab", "rt/a/b", "rt/ba", "rt/", "rt/]", "rt", "rq/a", "x", "xa", "rt/?", "*")
FAST = "fastdds-2.9"
PARTITIONS: tuple[tuple[str, ...], ...] = ((), ("p",))
DOMAINS = (0, 1, 2)
_EXPRESSIONS = ("*", "*", "*", "rt/*", "rt/a", "rt/b", "rt/a*", "rt/?", "*b", "r[tq]/*", "x", "rt/[!a]")
_LISTED = ("<id>0</id>", "<id>0</id>", "<id>1</id>", "<id>0</id><id>2</id>",
           "<id_range><min>0</min><max>1</max></id_range>", "<id_range><min>0</min></id_range>")  # fmt: skip
_HERE = Origin("policy")
Check = Callable[["Case", bytes, Counter[str]], Iterable[str]]
"""Counts, and yields the errors of a case and its permissions document."""


@dataclass(frozen=True)
class Topic:
    """A topic rule."""

    expression: str
    read: bool
    write: bool


@dataclass(frozen=True)
class Domain:
    """A domain rule."""

    listed: str
    join: bool
    unauthenticated: bool
    topics: tuple[Topic, ...]

    def applies(self, domain: int, *, exact: bool) -> bool:
        """Tell whether the rule applies to a domain; ``exact``: a minimum alone means one domain, as for vendors."""
        if "<max>" in self.listed:
            return domain <= 1
        if "<min>" in self.listed:
            return domain == 0 if exact else True
        return f"<id>{domain}</id>" in self.listed


@dataclass(frozen=True)
class Case:
    """A governance, a grant, and a policy, from which the grant may differ."""

    domains: tuple[Domain, ...]
    granted: tuple[tuple[str, str, str], ...]
    policy: tuple[tuple[str, str, str], ...]


class Cases:
    """Random cases."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def next(self) -> Case:
        """Return the next case."""
        some = self._random
        policy = tuple(self._rule() for _ in range(some.choice([0, 1, 2, 3])))
        granted = policy if self._likely(70) else tuple(self._rule() for _ in range(some.choice([0, 1, 2])))
        return Case(tuple(self._domain() for _ in range(some.choice([1, 1, 2]))), granted, policy)

    def _likely(self, percent: int) -> bool:
        return self._random.randrange(100) < percent

    def _domain(self) -> Domain:
        some = self._random
        topics = [self._topic() for _ in range(some.choice([0, 1, 2, 3]))]
        if self._likely(75) or not topics:
            topics.append(Topic("*", self._likely(85), self._likely(85)))
        return Domain(some.choice(_LISTED), self._likely(80), self._likely(10), tuple(topics))

    def _topic(self) -> Topic:
        some = self._random
        closed = self._likely(50)
        return Topic(some.choice(_EXPRESSIONS), closed or self._likely(50), closed or self._likely(50))

    def _rule(self) -> tuple[str, str, str]:
        some = self._random
        return some.choice(["allow", "allow", "deny"]), some.choice(ACTIONS), some.choice([*_EXPRESSIONS, *NAMES])


def governance_of(case: Case) -> bytes:
    """Return the governance document of a case."""
    rules = "".join(
        f"<domain_rule>\n<domains>{each.listed}</domains>\n"
        f"<allow_unauthenticated_participants>{_boolean(each.unauthenticated)}</allow_unauthenticated_participants>\n"
        f"<enable_join_access_control>{_boolean(each.join)}</enable_join_access_control>\n"
        "<discovery_protection_kind>NONE</discovery_protection_kind>\n"
        "<liveliness_protection_kind>NONE</liveliness_protection_kind>\n"
        "<rtps_protection_kind>NONE</rtps_protection_kind>\n"
        f"<topic_access_rules>{''.join(map(_topic_rule, each.topics))}</topic_access_rules></domain_rule>\n"
        for each in case.domains
    )
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    return f"{head}<dds><domain_access_rules>{rules}</domain_access_rules></dds>\n".encode()


def _topic_rule(topic: Topic) -> str:
    return (
        f"<topic_rule>\n<topic_expression>{escape(topic.expression)}</topic_expression>\n"
        "<enable_discovery_protection>false</enable_discovery_protection>\n"
        "<enable_liveliness_protection>false</enable_liveliness_protection>\n"
        f"<enable_read_access_control>{_boolean(topic.read)}</enable_read_access_control>\n"
        f"<enable_write_access_control>{_boolean(topic.write)}</enable_write_access_control>\n"
        "<metadata_protection_kind>NONE</metadata_protection_kind>\n"
        "<data_protection_kind>NONE</data_protection_kind></topic_rule>\n"
    )


def _boolean(value: bool) -> str:
    return "true" if value else "false"


def permissions_of(case: Case, subject: str, now: datetime) -> bytes:
    """Return the permissions document of a case: deny rules first, in domain 0."""
    rules = "".join(
        f"<{effect}_rule><domains><id>0</id></domains>\n<{action}><topics><topic>{escape(expression)}</topic></topics>"
        f"</{action}></{effect}_rule>\n"
        for group in ("deny", "allow")
        for effect, action, expression in case.granted
        if effect == group
    )
    begin, end = (f"{now + timedelta(days=days):%Y-%m-%dT%H:%M:%S}" for days in (-2, 900))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<dds><permissions><grant name="g">'
        f"<subject_name>{escape(subject)}</subject_name>"
        f"<validity><not_before>{begin}</not_before><not_after>{end}</not_after></validity>"
        f"{rules}<default>DENY</default></grant></permissions></dds>\n"
    ).encode()


def by_policy(case: Case, action: str, topic: str, partitions: Sequence[str], domain: int) -> bool:
    """Decide by the policy: deny overrides, and only the default partition is allowed."""
    if domain != 0:
        return False
    effects = [effect for effect, own, expression in case.policy if own == action and _matches(expression, topic)]
    return "deny" not in effects and "allow" in effects and not any(partitions)


def by_permissions(
    case: Case, model: str, action: str, topic: str, partitions: Sequence[str], domain: int, *, topic_check: bool = True
) -> bool:
    """Decide by the grant alone."""
    if domain != 0 and model != FAST:
        return False
    rules = [each for effect in ("deny", "allow") for each in case.granted if each[0] == effect]
    if model == "cyclonedds-0.10" and topic_check:
        named = next((effect for effect, _, expression in rules if _matches(expression, topic, model)), "deny")
        if named == "deny":
            return False
    for effect, own, expression in rules:
        if own != action or not _matches(expression, topic, model):
            continue
        if effect == "deny" and (model != "cyclonedds-0.10" or not any(partitions)):
            return False
        if effect == "allow" and model == FAST:
            return not any(partitions)  # the first rule that names the topic decides
        if effect == "allow" and not any(partitions):
            return True
    return False


def by_documents(case: Case, model: str, action: str, topic: str, partitions: Sequence[str], domain: int) -> bool:
    """Decide by governance and grant."""
    exact = model != "omg"
    rule = next((each for each in case.domains if each.applies(domain, exact=exact)), None)
    if rule is None:
        return False
    fast = model == FAST
    joins = any(effect == "allow" for effect, _, _ in case.granted) and (domain == 0 or fast)
    if not joins and (fast or (rule.join and all(each.read and each.write for each in rule.topics))):
        return False
    topic_rule = next((each for each in rule.topics if _matches(each.expression, topic, model, governance=True)), None)
    if topic_rule is None:
        return False
    if not (topic_rule.write if action == "publish" else topic_rule.read):
        return True
    check = topic_rule.read and topic_rule.write
    return by_permissions(case, model, action, topic, partitions, domain, topic_check=check)


def _matches(expression: str, topic: str, model: str = "", *, governance: bool = False) -> bool:
    """Match as a model does; in a governance, Fast DDS also uses the topic as a pattern for the expression."""
    if model == "cyclonedds-0.10":
        expression = expression.replace("[!", "[!]") if "[!" in expression else expression.replace("[", "[]")
    if governance and model == FAST and fnmatch.fnmatchcase(expression, topic):
        return True
    return fnmatch.fnmatchcase(topic, expression)


def rules_of(case: Case, subject: str) -> SubjectRules:
    """Return the policy of a case."""
    return SubjectRules(
        subject,
        tuple(Rule(Effect(e.upper()), "topic", (action,), (x,), (), False, _HERE) for e, action, x in case.policy),
    )


def claims_of(case: Case, permissions: bytes, subject: str) -> tuple[Claim, ...]:
    """Return the claims about the documents of a case."""
    rules = rules_of(case, "/robot")
    task = ComparisonTask(
        permissions, "permissions.xml", 0, subject, rules, "humble", (DomainRange(0, 0),), 50_000, lambda: True
    )
    governing = EnclaveGovernance(governance_of(case), ("governance.p7s", 0), None)
    return prove_document(ProofQuestion(signed_permissions.read(permissions), task, lower(rules, "humble"), governing))


def wrong_claims(case: Case, claims: Sequence[Claim], counts: Counter[str]) -> Iterator[str]:
    """Yield the errors of claims, found by brute force."""
    for model in MODELS:
        for domain in DOMAINS:
            for action in ACTIONS:
                covered = [
                    claim
                    for claim in claims
                    if (claim.model, claim.action) == (model, action)
                    and any(each.first <= domain <= each.last for each in claim.domains)
                ]
                differing = [
                    (name, partitions)
                    for name in NAMES
                    for partitions in PARTITIONS
                    if not (model == FAST and set(name) & set("*?["))
                    and not (model == FAST and domain and not _opened(case, action, name, domain))
                    and by_policy(case, action, name, partitions, domain)
                    != by_documents(case, model, action, name, partitions, domain)
                ]
                if differing and not any(claim.proof is Proof.COUNTEREXAMPLE for claim in covered):
                    yield f"missed: {model} {action} in domain {domain}: {differing[:3]}"
                counts["differing"] += bool(differing)
    for claim in claims:
        counts[f"claims {claim.proof}"] += 1
        if claim.proof is Proof.UNKNOWN:
            yield f"unknown: {claim}"
        if claim.counterexample is None or claim.action not in ACTIONS:
            continue
        example = claim.counterexample
        endpoint = example.endpoint
        name, partitions, domain = endpoint.name, endpoint.partitions, endpoint.domain
        allowed = by_policy(case, claim.action, name, partitions, domain)
        permitted = by_documents(case, claim.model, claim.action, name, partitions, domain)
        alone = by_permissions(case, claim.model, claim.action, name, partitions, domain)
        peers = "peers evaluate their own" in example.document.reason
        decided = alone if peers else permitted
        if not allowed == example.policy.allowed != example.document.allowed == decided:
            yield f"no counterexample: {claim}"
        counts["of permissions alone"] += peers
    yield from _of_domains(case, claims)


def _opened(case: Case, action: str, topic: str, domain: int) -> bool:
    """Tell whether the governance opens a topic for vendors.

    The claims about Fast DDS assume that permissions of other domains apply too.
    """
    rule = next((each for each in case.domains if each.applies(domain, exact=True)), None)
    topic_rule = next((each for each in rule.topics if _matches(each.expression, topic)), None) if rule else None
    return topic_rule is not None and not (topic_rule.write if action == "publish" else topic_rule.read)


def _of_domains(case: Case, claims: Sequence[Claim]) -> Iterator[str]:
    for domain in DOMAINS:
        for model in MODELS:
            rule = next((each for each in case.domains if each.applies(domain, exact=model != "omg")), None)
            opens = rule is not None and (not rule.join or rule.unauthenticated)
            reported = any(
                claim.action == "join" and any(each.first <= domain <= each.last for each in claim.domains)
                for claim in claims
                if claim.model == model
            )
            if opens != reported:
                yield f"join: {model} in domain {domain}: {opens}, reported {reported}"


class Bench:
    """Compares brute force with the models and the vendors."""

    def __init__(self) -> None:
        self.now = datetime.now(UTC)
        self._authorities = Authorities.new()
        certificate, _ = self._authorities.identity.issue(RDNS)
        self._certificate = certificate.public_bytes(serialization.Encoding.PEM)
        self.subject = subject_name(self._certificate, Origin("cert.pem"))

    def modelled(self, case: Case, permissions: bytes, counts: Counter[str]) -> Iterator[str]:
        """Yield the differences between the models and brute force, and the errors of claims."""
        document, governance = signed_permissions.read(permissions), signed_governance.read(governance_of(case))
        for model in MODELS:
            variation = VARIATIONS[model]
            for domain in DOMAINS:
                evaluator = DocumentEvaluator(document, self.subject, self.now, domain, variation)
                access = DomainAccess(governance, domain, evaluator.semantics)
                for action, name, partitions in _requests():
                    decided = access.decide(evaluator, action, name, partitions)
                    expected = by_documents(case, model, action, name, partitions, domain)
                    counts["model"] += 1
                    if decided.allowed != expected:
                        request = f"{action} {name} {partitions} in {domain}"
                        yield f"model {model}: {request}: brute force {expected}, {decided}"
        yield from wrong_claims(case, claims_of(case, permissions, self.subject), counts)

    def cyclone(self, case: Case, permissions: bytes, counts: Counter[str]) -> Iterator[str]:
        """Yield the differences between Cyclone DDS and brute force."""
        authority = self._authorities.permissions
        signed, governance = authority.sign(permissions.decode()), authority.sign(governance_of(case).decode())
        for domain in DOMAINS:
            with access_control(
                certificate=self._certificate,
                permissions_ca=authority.pem,
                governance=governance,
                permissions=signed,
                domain=domain,
            ) as access:
                if not access.valid:
                    yield f"cyclone refuses: {access.reason}"
                    return
                joins = access.joins()
                for action, name, partitions in _requests():
                    allowed = joins and access.allows(action, name, partitions)  # type: ignore[arg-type]
                    expected = by_documents(case, "cyclonedds-0.10", action, name, partitions, domain)
                    counts["cyclone"] += 1
                    counts["cyclone allows"] += allowed
                    if allowed != expected:
                        yield f"cyclone: {action} {name} {partitions} in {domain}: {allowed}, brute force {expected}"

    def fast(self, vendor: Vendor, folder: Path, case: Case, permissions: bytes, counts: Counter[str]) -> Iterator[str]:
        """Yield the differences between Fast DDS and brute force, in domain 0."""
        governance = governance_of(case).decode()
        self._authorities.enclave(folder, rdns=RDNS, permissions=permissions.decode(), governance=governance)
        try:
            with System(vendor) as system:
                try:
                    participant = system.open(folder)
                except RefusedError:
                    participant = None
                for action, topic, partitions in _requests():
                    allowed = participant is not None and participant.allows(action, topic, partitions)  # type: ignore[arg-type]
                    expected = by_documents(case, FAST, action, topic, partitions, 0)
                    counts["fastdds"] += 1
                    counts["fastdds allows"] += allowed
                    if allowed != expected:
                        yield f"fastdds: {action} {topic} {partitions}: {allowed}, brute force {expected}"
        except ProcessFailedError as error:
            yield f"fastdds: {error}"


def _requests() -> Iterator[tuple[str, str, tuple[str, ...]]]:
    return ((action, name, partitions) for action in ACTIONS for name in NAMES for partitions in PARTITIONS)


def compare(bench: Bench, seed: int, documents: int, check: Check) -> tuple[Counter[str], list[str]]:
    """Check as many random cases as ``documents``; return counts and errors."""
    cases, counts, wrong = Cases(seed), Counter[str](), []
    for number in range(documents):
        case = cases.next()
        permissions = permissions_of(case, bench.subject, bench.now)
        wrong += [f"case {number} of seed {seed}: {each}\n  {case}" for each in check(case, permissions, counts)]
    return counts, wrong
