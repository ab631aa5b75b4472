# SPDX-License-Identifier: Apache-2.0
"""Prove an installed enclave, or refute it: the router permits what the policy allows, and its sessions know it only.

The claims are by message and flow, about all literal keys. That the key expressions of a pattern match exactly the
names that the pattern matches is proven here too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import product

from comarmor.patterns import glob
from comarmor.patterns.decision_lists import BudgetError, Equal, ProofResult, SearchBudget, Unknown, Witness
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import spend, step_counting_cache
from comarmor.rules import Effect
from comarmor.values import Data
from keymint.api import Claim, Counterexample, DomainRange, Endpoint, PolicyDecision, Proof, ProofTask, Verdict
from keymint.errors import Diagnostic, Reason, require_none
from keymint.pki.examine import enclave_file
from keymint_ros2_zenoh.decision import AccessModel, KeyLists, LinkAccess, first_common_name
from keymint_ros2_zenoh.documents.configuration import Flow, Message
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, ROUTER, SESSION
from keymint_ros2_zenoh.examine import configurations
from keymint_ros2_zenoh.examine.enclaves import differences
from keymint_ros2_zenoh.identities import common_name, router_of
from keymint_ros2_zenoh.keyexpr import KeyExpr, includes, intersects, key_exprs
from keymint_ros2_zenoh.lowering import permissions
from keymint_ros2_zenoh.lowering.key_rules import NameRules, domain_ids, name_rules, slot_rules
from keymint_ros2_zenoh.lowering.permissions import action
from keymint_ros2_zenoh.proving import policy_evaluator
from keymint_ros2_zenoh.proving.key_search import Automaton, Side, difference, side_of
from keymint_ros2_zenoh.settings import is_router


class PolicySide(Data):
    """The rights of a subject by its policy.

    Attributes:
        names: its rules by permission.
        domains: the ids of its domains.
    """

    names: NameRules
    domains: tuple[int, ...]

    def permitted(self, message: Message, flow: Flow) -> KeyLists:
        """Return what the policy permits: an entry for each permission that needs the message on data.

        What is permitted beside data and for the graph is part of the first entry: no key belongs to two of these, so
        that a denial of one concerns no other.
        """
        entries: dict[permissions.Place, KeyLists] = {}
        for place in permissions.Place:
            needing = sorted(permissions.USERS[permissions.Slot(message, flow, place)])
            patterns = ([self.names.patterns(effect, permission) for effect in Effect] for permission in needing)
            entries[place] = tuple((self._keys(place, allow), self._keys(place, deny)) for allow, deny in patterns)
        (allowed, denied), *others = entries[permissions.Place.DATA] or [((), ())]
        for more_allowed, more_denied in entries[permissions.Place.ADVANCED]:
            allowed, denied = (*allowed, *more_allowed), (*denied, *more_denied)
        return ((*allowed, *self._graph(message, flow)), denied), *others

    def expressible(self, message: Message, flow: Flow) -> KeyLists:
        """Return what one list of denials can express: where permissions share a message, more than :meth:`permitted`.

        It permits a reply on names that one permission is denied and another one is allowed on other names of the same
        rule; see :data:`keymint_ros2_zenoh.lowering.permissions.SLOTS` for why this is no right.
        """
        lists: dict[Effect, list[KeyExpr]] = {effect: [] for effect in Effect}
        for effect, slots, pattern, _ in slot_rules(self.names):
            for slot in slots:
                if (slot.message, slot.flow) == (message, flow):
                    lists[effect] += self._keys(slot.place, (pattern,))
        lists[Effect.ALLOW] += self._graph(message, flow)
        return ((tuple(lists[Effect.ALLOW]), tuple(lists[Effect.DENY])),)

    def unproven(self, states: int) -> str:
        """Return why the key expressions of a pattern are not proven to match the same names; empty if all are."""
        for pattern in dict.fromkeys(each.pattern for each in self.names.rules):
            result = proven_exact(pattern, states)
            if result != Equal():
                return f"the key expressions of {exact(pattern)!r} are not proven to match the same names: {result}"
        return ""

    def _keys(self, place: permissions.Place, patterns: Sequence[Glob]) -> tuple[KeyExpr, ...]:
        return tuple(
            permissions.name_key(domain, name, place)
            for pattern in patterns
            for name in key_exprs(pattern)
            for domain in self.domains
        )

    def _graph(self, message: Message, flow: Flow) -> Iterator[KeyExpr]:
        for domain in self.domains:
            if (message, flow) == (Message.LIVELINESS_TOKEN, Flow.INGRESS):
                yield permissions.own_tokens_key(domain, self.names.subject)
            if (message, flow) in permissions.GRAPH_SLOTS:
                yield permissions.graph_key(domain)


def proven_exact(pattern: Glob, states: int) -> ProofResult:
    """Compare a pattern of ROS names with its key expressions, as keys of domain 0 with any type and hash.

    Args:
        pattern: pattern of names.
        states: the most states that the search may visit.
    """
    try:
        return _decided(pattern, states)
    except BudgetError as error:
        return Unknown(str(error))


# Many enclaves have the same patterns. What is unknown is not cached: it may depend on an outer limit.
@step_counting_cache
def _decided(pattern: Glob, states: int) -> ProofResult:
    automaton = Automaton()
    names = frozenset(automaton.names(0, rest) for rest in glob.left_quotient(pattern, "/"))
    keys = frozenset(automaton.key_expr(permissions.name_key(0, each)) for each in key_exprs(pattern))
    left, right = (side_of(((nodes, frozenset()),)) for nodes in (names, keys))
    result = difference(automaton, left, right, SearchBudget(states))
    if isinstance(result, Unknown):
        raise BudgetError(result.reason)
    return result


MODEL = "zenoh-1"
_MEETING = 4
"""Steps of a comparison of two key expressions."""
UNIVERSE = "all literal keys; the names in them are legal ROS names"
_REPLIES = (
    "replies about names for which one rule denies a permission and another rule allows the one that shares the reply: "
    "no query reaches the subject there"
)


def prove_rights(task: ProofTask, router: LinkAccess, session: LinkAccess) -> Iterator[Claim]:
    """Yield a claim for each message and flow.

    Args:
        task: what the policy allows the enclave.
        router: what the router permits on links of the enclave.
        session: what the enclave's own configuration permits on links to the router.

    Raises:
        KeymintError: Zenoh cannot express a rule of the policy.
    """
    policy = PolicySide(name_rules(task.rules, task.package.distro), domain_ids(task.package.grant.domains))
    unknown = router.unmodelled or policy.unproven(task.states)
    proof = _Rights(task, policy, router, session)
    for message, flow in product(Message, Flow):
        if unknown:
            yield proof.claim(message, flow, Proof.UNKNOWN, unknown, spent=not router.unmodelled)
        else:
            yield proof.of(message, flow)


class _Rights:
    """Makes the claims of one enclave."""

    def __init__(self, task: ProofTask, policy: PolicySide, router: LinkAccess, session: LinkAccess) -> None:
        self._task = task
        self._policy = policy
        self._router = router
        self._session = session
        self._automaton = Automaton()
        self._known: dict[tuple[Side, Side], ProofResult] = {}
        self._meeting: dict[tuple[tuple[KeyExpr, ...], tuple[KeyExpr, ...]], tuple[KeyExpr, ...]] = {}

    def claim(
        self, message: Message, flow: Flow, proof: Proof, reason: str = "", example: Counterexample | None = None,
        *, spent: bool = False, excepted: tuple[str, ...] = (),
    ) -> Claim:  # fmt: skip
        """Return a claim about a message and a flow."""
        domains = self._task.package.grant.domains
        return Claim(MODEL, action(message, flow), domains, UNIVERSE, proof, reason, example, spent, excepted)

    def of(self, message: Message, flow: Flow) -> Claim:
        """Return the claim about a message and a flow."""
        router = self._side(self._router.keys(message, flow), everything=self._router.open)
        result = self._compare(self._side(self._policy.permitted(message, flow)), router)
        excepted: tuple[str, ...] = ()
        if isinstance(result, Witness) and message is Message.REPLY and not result.left:
            again = self._compare(self._side(self._policy.expressible(message, flow)), router)
            excepted = (_REPLIES,) if again == Equal() else ()
            # A key counts only if the policy decides on it as the side that it was found with.
            if not isinstance(again, Witness) or self._decision(message, flow, again.word).allowed is again.left:
                result = again
        if isinstance(result, Unknown):
            return self.claim(message, flow, Proof.UNKNOWN, result.reason, spent=True)
        if isinstance(result, Witness):
            return self._refuted(message, flow, result)
        return self._in_session(message, flow) or self.claim(message, flow, Proof.PROVEN, excepted=excepted)

    def _in_session(self, message: Message, flow: Flow) -> Claim | None:
        """Return a claim that is not proven because the enclave's own configuration restricts what is permitted."""
        session = self._session
        if session.unmodelled:
            reason = f"the configuration of the enclave's own sessions: {session.unmodelled}"
            return self.claim(message, flow, Proof.UNKNOWN, reason)
        own, permitted = session.keys(message, flow.opposite), self._policy.permitted(message, flow)
        needed = [key for allowed, _ in permitted for key in allowed]
        if any(not denied and (session.open or _include(allowed, needed)) for allowed, denied in own):
            return None
        side = self._side(own, everything=session.open)
        result = self._compare(side_of((*self._side(permitted), *side)), side)
        if isinstance(result, Unknown):
            return self.claim(message, flow, Proof.UNKNOWN, result.reason, spent=True)
        if isinstance(result, Equal):
            return None
        reason = "the configuration of the enclave's own sessions does not permit it"
        verdict = Verdict(allowed=False, reason=reason, where=session.where)
        return self._counterexample(message, flow, result.word, verdict)

    def _decision(self, message: Message, flow: Flow, key: str) -> PolicyDecision:
        return policy_evaluator.decide(self._task.rules, self._policy.domains, key, message, flow)

    def _side(self, lists: KeyLists, *, everything: bool = False) -> Side:
        """Return key expressions as nodes, without denials that concern nothing that is allowed.

        Args:
            lists: key expressions by entry.
            everything: each entry also allows all other keys.
        """
        nodes = self._automaton
        more = (nodes.everything,) if everything else ()
        return side_of(
            (
                frozenset((*map(nodes.key_expr, allowed), *more)),
                frozenset(map(nodes.key_expr, denied if everything else self._concerned(allowed, denied))),
            )
            for allowed, denied in lists
        )

    def _concerned(self, allowed: tuple[KeyExpr, ...], denied: tuple[KeyExpr, ...]) -> tuple[KeyExpr, ...]:
        """Return the denied key expressions that match a key which one of the allowed ones matches."""
        lists = (allowed, denied)
        if lists not in self._meeting:
            spend(_MEETING * len(allowed) * len(denied))
            self._meeting[lists] = tuple(key for key in denied if any(intersects(key, other) for other in allowed))
        return self._meeting[lists]

    def _compare(self, policy: Side, router: Side) -> ProofResult:
        key = (policy, router)
        if key not in self._known:
            budget = SearchBudget(self._task.states, self._task.go_on)
            self._known[key] = difference(self._automaton, policy, router, budget)
        return self._known[key]

    def _refuted(self, message: Message, flow: Flow, witness: Witness) -> Claim:
        key = witness.word
        decided = self._router.decide(message, flow, key)
        if self._decision(message, flow, key).allowed is not witness.left or decided.allowed is witness.left:
            return self.claim(
                message, flow, Proof.UNKNOWN,
                f"the engine and the plain evaluators disagree on {key!r}: a defect of Keymint",
            )  # fmt: skip
        verdict = Verdict(decided.allowed, decided.reason, decided.where or self._router.where)
        return self._counterexample(message, flow, key, verdict)

    def _counterexample(self, message: Message, flow: Flow, key: str, verdict: Verdict) -> Claim:
        """Return the claim that a message on a key refutes, with the policy's decision and another one."""
        subject, meaning = self._task.rules.subject, policy_evaluator.meaning_of(key)
        endpoint = Endpoint(subject, action(message, flow), key, domain=meaning[0] if meaning else 0)
        edge = next(policy_evaluator.edges(subject, key, message, flow), None)
        example = Counterexample(endpoint, edge, self._decision(message, flow, key), verdict)
        return self.claim(message, flow, Proof.COUNTEREXAMPLE, "", example)


def _include(outer: Iterable[KeyExpr], inner: Iterable[KeyExpr]) -> bool:
    """Return whether each key expression is included in one of others."""
    return all(any(includes(each, key) for each in outer) for key in inner)


CONNECT, ROUTE, IDENTIFY = "connect", "route", "identify"
_ABOUT_CONFIGURATIONS: Mapping[str, tuple[str, str]] = {
    CONNECT: (
        "the sessions of the enclave that its configuration describes",
        "a session must exchange messages with the router alone",
    ),
    ROUTE: ("all links of the router", "the router must decide on every message, by the certificate of its sender"),
    IDENTIFY: (
        "all certificates of the workspace's authority",
        "each enclave must have one subject entry with its common name, and nobody else one",
    ),
}
"""What the claims about configurations cover, and what should be, in words, by their action."""
ASSUMPTIONS: Mapping[str, tuple[str, ...]] = {
    MODEL: (
        "configurations are read and decided as Zenoh 1.10 was measured to do it",
        "the router runs with the installed file, reads it at its start, and is not compromised",
        "names are mapped to keys as rmw_zenoh does it; nodes of one process are one subject",
        "names consist of the characters of ROS names; keys with wildcards are the subject of a claim of their own",
        "every enclave may announce its own nodes and read the graph",
    )
}


def prove(task: ProofTask) -> tuple[Claim, ...]:
    """Return the claims about an enclave; none about the router, which is no subject of the policy.

    Raises:
        KeymintError: a file is missing, cannot be read, or does not rest on the workspace's authorities; or Zenoh
            cannot express a rule of the policy.
    """
    package, enclave = task.package, task.enclave
    if is_router(package):
        return ()
    require_none(differences(enclave))
    router = common_name(router_of(package))
    session = read(enclave_file(enclave.files, enclave.folder, SESSION), f"{enclave.folder}/{SESSION}")
    model = router_access(enclave.shared[ROUTER], f"{enclave.shared_folder}/{ROUTER}")
    at_router = model.of_certificate(first_common_name(enclave.files[CERTIFICATE]))
    at_session = AccessModel(session.access_control).of_certificate(router)
    rights = tuple(prove_rights(task, at_router, at_session))
    refuting = (
        *configurations.by_itself(session, package),
        *configurations.open_default(session),
        *configurations.pin_findings(session, router),
    )
    unmodelled = configurations.unmodelled_setting(session, router=False)
    return (*rights, configuration_claim(CONNECT, package.subject, refuting, unmodelled, package.grant.domains))


# All enclaves rest on the same file.
@lru_cache(maxsize=4)
def router_access(content: bytes, file: str) -> AccessModel:
    """Return the model of a router's access control.

    Raises:
        KeymintError: it cannot be read.
    """
    return AccessModel(read(content, file).access_control)


def configuration_claim(
    action: str, subject: str, found: Sequence[Diagnostic], unmodelled: str = "", domains: tuple[DomainRange, ...] = ()
) -> Claim:
    """Return a claim about a configuration, which the first finding on it refutes.

    Args:
        action: the action of the claim, one of :data:`_ABOUT_CONFIGURATIONS`.
        subject: whom it is about; empty for all.
        found: what refutes it.
        unmodelled: why it is unknown; empty if it is not.
        domains: the domains that it covers.
    """
    universe, expected = _ABOUT_CONFIGURATIONS[action]
    if not found:
        return Claim(MODEL, action, domains, universe, Proof.UNKNOWN if unmodelled else Proof.PROVEN, unmodelled)
    first, more = found[0], len(found) - 1
    message = first.message + (f" (and {more} more)" if more else "")
    policy = PolicyDecision(allowed=False, where=None, reason=Reason((expected,)))
    verdict = Verdict(allowed=True, reason=message, where=first.where)
    help_ = "'keymint build' and 'keymint install' write the file of the sources"
    endpoint = Endpoint(subject, action, "", domain=domains[0].first if domains else 0)
    example = Counterexample(endpoint, None, policy, verdict, help_, first.where, expected)
    return Claim(MODEL, action, domains, universe, Proof.COUNTEREXAMPLE, "", example)


def assumptions() -> Mapping[str, Sequence[str]]:
    """Return the assumptions of all claims by model."""
    return ASSUMPTIONS
