# SPDX-License-Identifier: Apache-2.0
"""Evaluate a policy for one literal key by its rules; independent of the compiler, to check its translation."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob, matches
from comarmor.patterns.tokens import Charset, charset
from comarmor.rules import Effect, suffixes
from keymint.api import PolicyDecision
from keymint.api.graph import Edge, Object
from keymint.errors import Reason
from keymint.ir import Rule, SubjectRules
from keymint_ros2_zenoh.documents.configuration import Flow, Message
from keymint_ros2_zenoh.keyexpr import ALPHABET, VERBATIM
from keymint_ros2_zenoh.lowering import permissions

KIND = {
    "ros_publish": "ros_topic", "ros_subscribe": "ros_topic", "ros_call": "ros_service", "ros_execute": "ros_service",
}  # fmt: skip
"""The kind of each permission."""
_ROS_NAMES = charset((ord(char), ord(char)) for char in ALPHABET)


def meaning_of(key: str) -> tuple[int, str, permissions.Place] | None:
    """Return what a literal key is about, or None for a key that no topic or service has.

    Returns:
        The domain id, the topic or service, and which of its keys it is.
    """
    chunks = key.split("/")
    place = permissions.Place.DATA
    if permissions.ADVANCED in chunks:
        chunks, place = chunks[: chunks.index(permissions.ADVANCED)], permissions.Place.ADVANCED
    domain, *name = chunks[: -len(permissions.TYPE_AND_HASH)] or ("",)
    if not name or not domain.isdecimal() or any(chunk.startswith(VERBATIM) for chunk in chunks):
        return None
    return (int(domain), f"/{'/'.join(name)}", place) if str(int(domain)) == domain else None


def edges(subject: str, key: str, message: Message, flow: Flow) -> Iterator[Edge]:
    """Yield the edges that need a message on a key, topics before services."""
    meaning = meaning_of(key)
    if meaning is not None:
        domain, name, place = meaning
        for permission, kind in KIND.items():
            if permission in permissions.USERS[permissions.Slot(message, flow, place)]:
                yield Edge(subject, permission, Object(kind, name), domain)


def decide(rules: SubjectRules, domains: tuple[int, ...], key: str, message: Message, flow: Flow) -> PolicyDecision:
    """Return the policy's decision on a message with a literal key."""
    if key.startswith(f"{permissions.GRAPH}/"):
        return _of_graph(rules.subject, domains, key, message, flow)
    denial: PolicyDecision | None = None
    for edge in edges(rules.subject, key, message, flow):
        if edge.domain not in domains:
            return PolicyDecision(allowed=False, where=None, reason=Reason(("not its domain",)))
        about = [rule for rule in rules.rules if _is_about(rule, edge)]
        rule = next((rule for rule in about if rule.effect is Effect.DENY), about[0] if about else None)
        if rule is None:
            continue
        verb = "allows" if rule.effect is Effect.ALLOW else "denies"
        reason = Reason((f"the {rule.kind} rule {verb} it",))
        decision = PolicyDecision(rule.effect is Effect.ALLOW, rule.origin, reason, rule.audit)
        if decision.allowed:
            return decision
        denial = denial or decision
    return denial or PolicyDecision(allowed=False, where=None, reason=Reason(("no rule allows it",)))


def _is_about(rule: Rule, edge: Edge) -> bool:
    name = edge.object.name
    return any(
        name.endswith(suffix) and matches(_pattern(expression), name.removesuffix(suffix))
        for suffix in suffixes(rule, edge.object.kind, edge.permission)
        for expression in rule.expressions
    )


@lru_cache(maxsize=1 << 10)
def _pattern(expression: str) -> Glob:
    """Return an expression whose sets match characters of ROS names only (docs/adr/0025-proofs-zenoh.md)."""
    tokens = glob.parse(expression)
    return tuple(token.intersection(_ROS_NAMES) if isinstance(token, Charset) else token for token in tokens)


def _of_graph(subject: str, domains: tuple[int, ...], key: str, message: Message, flow: Flow) -> PolicyDecision:
    """Decide about a token of the graph: an enclave reads all of its domains, and announces its own nodes."""
    chunks = key.split("/")
    known = chunks[1] in map(str, domains) and not any(chunk.startswith(VERBATIM) for chunk in chunks[1:])
    reads = (message, flow) in permissions.GRAPH_SLOTS
    announces = (message, flow) == (Message.LIVELINESS_TOKEN, Flow.INGRESS)
    own = chunks[permissions.TOKEN_ENCLAVE : permissions.TOKEN_ENCLAVE + 1] == [subject.replace("/", "%")]
    allowed = known and (reads or (announces and own))
    reason = "every enclave may do so" if allowed else "no enclave may do so"
    return PolicyDecision(allowed, None, Reason((reason,)))
