# SPDX-License-Identifier: Apache-2.0
"""Find rules that are correct in form, but name the wrong object, or grant the wrong side of it.

Such are rights on every object, a parameter where a node is expected, and a service that several subjects serve while
nobody may call it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from comarmor.patterns.glob import literal, parse, prefix
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.rules import KIND_OF, Effect
from comarmor.text import quantity
from keymint.analysis.findings import ExpressionOrigins, undecided_note
from keymint.analysis.name_similarity import MOST_EDITS, CandidateNames
from keymint.analysis.query import who_can
from keymint.api import LoadedPolicy
from keymint.errors import Diagnostic, Origin, Spot
from keymint.ir import Rule

_READING = frozenset({"subscribe", "ros_subscribe", "ros_read"})
"""Permissions that change nothing in other nodes: recorders and monitors have them on every object."""
_SERVED = "/get_parameters"
"""What follows the name of a node in the name of a service that each node with parameters serves."""
_CALL = {"ros_execute": "ros_call", "ros_operate": "ros_request"}
"""The permission of clients, by that of servers."""
_EVERYBODY = parse("*")
MOST_QUESTIONS = 50
"""So often all possible subjects are asked about: each question takes as long as the policy is."""
_EVERY_NAME = frozenset(map(parse, ("*", "/*", "?*", "/?*")))
_Expression = tuple[Rule, str, str]
"""A rule, one of its expressions, and the first subject that the rule applies to."""


def object_mistakes(
    policy: LoadedPolicy,
    subjects: Mapping[str, tuple[Rule, ...]],
    others: Iterable[Rule],
    attachments: ExpressionOrigins,
) -> Iterator[Diagnostic]:
    """Yield warnings about the objects of ALLOW rules, each cause once.

    Args:
        policy: the policy.
        subjects: the rules of each subject that it names.
        others: the rules of examples of all other subjects.
        attachments: attachments of their expressions.
    """
    allowed = [
        (rule, text, subject)
        for subject, rules in subjects.items()
        for rule in rules
        if rule.effect is Effect.ALLOW
        for text in rule.expressions
    ]
    first: dict[tuple[Spot, str], _Expression] = {}
    for each in allowed:
        first.setdefault((each[0].origin.spot, each[1]), each)
    expressions = tuple(first.values())

    def place(found: _Expression) -> Origin:
        rule, text, subject = found
        return attachments.of(rule, subject)[text].where

    yield from (_of_all(each, place(each)) for each in expressions if _is_wide(*each[:2]))
    if parameters := [each for each in expressions if each[0].kind == "ros_parameter"]:
        served = [text for rule, text, _ in expressions if "ros_execute" in rule.permissions]
        index = PatternIndex((parse(text), None) for text in served)
        nodes = {text.removesuffix(_SERVED) for text in served if text.endswith(_SERVED)}
        for each in parameters:
            if not any(True for _ in index.meeting(parse(each[1] + _SERVED))):
                yield from _of_parameter(each, place(each), nodes)
    yield from _uncalled(policy, allowed, others)


def _is_wide(rule: Rule, text: str) -> bool:
    every = "*" in text and parse(text) in _EVERY_NAME
    return every and not rule.audit and not _READING.issuperset(rule.permissions)


def _of_all(found: _Expression, where: Origin) -> Diagnostic:
    rule, text, subject = found
    permissions = ", ".join(each for each in rule.permissions if each not in _READING)
    message = f"this ALLOW {rule.kind} rule gives {permissions} on every {rule.kind}, since {text!r} matches all names"
    help_ = 'name what the node uses, e.g. /camera/*; if you mean every object, say so by modifier="AUDIT"'
    return Diagnostic.warning("object-any", message, where, help_, subject)


def _of_parameter(found: _Expression, where: Origin, nodes: set[str]) -> Iterator[Diagnostic]:
    """Yield the finding on the object of a ros_parameter rule that no node of the policy is, if a node is near."""
    _, text, subject = found
    start = prefix(parse(text)).rstrip("/")
    parents = [start[:at] for at in range(len(start), 0, -1) if start[at : at + 1] in ("", "/")]
    parent = next((each for each in parents if each in nodes), "")
    near = parent or CandidateNames(nodes).nearest(text, MOST_EDITS, [])
    if near:
        like = f"it looks like a parameter of the node {near}" if parent else "no node of the policy has this name"
        message = f"a ros_parameter rule names a node, and gives rights on all its parameters; {text!r}: {like}"
        yield Diagnostic.warning("parameter-object", message, where, f"did you mean {near!r}?", subject)


def _uncalled(policy: LoadedPolicy, allowed: Sequence[_Expression], others: Iterable[Rule]) -> Iterator[Diagnostic]:
    """Yield services and actions that several subjects serve and nobody may call.

    The subjects that the policy names are asked first, each about the names that its own rules are about. All possible
    subjects are asked only if other ones have the permission to call anything.
    """
    servers: dict[tuple[str, str], dict[str, Origin]] = defaultdict(dict)
    for rule, text, subject in allowed:
        for permission in _CALL.keys() & rule.permissions:
            servers[permission, text].setdefault(subject, rule.origin)
    callers = {
        call: PatternIndex((parse(text), subject) for rule, text, subject in allowed if call in rule.permissions)
        for call in _CALL.values()
    }
    called_by_others = {permission for rule in others for permission in rule.permissions}
    asked = 0
    for (permission, name), places in servers.items():
        if len(places) == 1 or literal(parse(name)) is None:
            continue
        kind, call = KIND_OF[permission], _CALL[permission]
        named = dict.fromkeys(parse(subject) for _, subject in callers[call].meeting(parse(name)))
        if any(True for each in named for _ in who_can(policy, each, kind, call, parse(name))):
            continue
        if call in called_by_others:
            asked += 1
            if asked > MOST_QUESTIONS:
                message = f"nobody asked whether anyone may {call} {name!r} and others that several subjects serve"
                yield undecided_note(message, "lint parts of the policy", places[next(iter(places))])
                return
            if any(True for _ in who_can(policy, _EVERYBODY, kind, call, parse(name))):
                continue
        (one, where), (two, other), *more_places = places.items()
        more = f" and {quantity(len(more_places), 'other subject')}" if more_places else ""
        yield Diagnostic.warning(
            "served-twice",
            f"{one} and {two} ({other.alone()}){more} may {permission} the {kind} {name!r}, and nobody may {call} it",
            where,
            f"{permission} is the right of the server: write {call} for the client",
            one,
        )
