# SPDX-License-Identifier: Apache-2.0
"""What a policy and a document mean, written down a second time, plainly and without the code under test.

``policy`` is the language (deny overrides, each partition by itself). ``omg``, ``cyclone`` and ``fastdds`` decide by an
emitted document: the standard's algorithm, and what the two vendors really do.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from lxml import etree

from comarmor.patterns import expression
from comarmor.rules import Effect
from keymint.ir import Rule, SubjectRules

_IMAGES = {
    ("ros_publish", "publish"): ("rt", ""),
    ("ros_subscribe", "subscribe"): ("rt", ""),
    ("ros_call", "publish"): ("rq", "Request"),
    ("ros_call", "subscribe"): ("rr", "Reply"),
    ("ros_execute", "subscribe"): ("rq", "Request"),
    ("ros_execute", "publish"): ("rr", "Reply"),
    ("publish", "publish"): ("", ""),
    ("subscribe", "subscribe"): ("", ""),
}
_ACTION = (("send_goal", True), ("cancel_goal", True), ("get_result", True), ("feedback", False), ("status", False))
_READ = ("describe_parameters", "get_parameters", "get_parameter_types", "list_parameters")
_WRITE = ("set_parameters", "set_parameters_atomically")


@lru_cache(maxsize=256)
def _elementary(rule: Rule):
    return tuple(_each_elementary(rule))


def _each_elementary(rule: Rule):
    """Yield (permission, expression) with the composite kinds written out."""
    for permission in rule.permissions:
        for text in rule.expressions:
            if permission in {"ros_request", "ros_operate"}:
                client = permission == "ros_request"
                for part, service in _ACTION:
                    kind = ("ros_call" if client else "ros_execute") if service else None
                    yield kind or ("ros_subscribe" if client else "ros_publish"), f"{text}/_action/{part}"
            elif permission in {"ros_read", "ros_write"}:
                for part in _READ if permission == "ros_read" else _WRITE:
                    yield "ros_call", f"{text}/{part}"
            else:
                yield permission, text


def _concerns(rule: Rule, action: str, topic: str) -> bool:
    for permission, text in _elementary(rule):
        image = _IMAGES.get((permission, action))
        if image is None:
            continue
        prefix, suffix = image
        if len(topic) < len(prefix + suffix) or not (topic.startswith(prefix) and topic.endswith(suffix)):
            continue
        name = topic[len(prefix) : len(topic) - len(suffix)]
        if prefix and not name.startswith("/"):
            continue
        if expression.matches(text, name):
            return True
    return False


def policy(rules: SubjectRules, action: str, topic: str, partitions: tuple[str, ...] = ()) -> bool:
    """Tell whether a policy permits an endpoint."""
    concerned = [rule for rule in rules.rules if _concerns(rule, action, topic)]

    def permitted(partition: str) -> bool:
        for rule in concerned:
            if rule.effect is Effect.DENY and (
                not rule.partitions or any(expression.matches(p, partition) for p in rule.partitions)
            ):
                return False
        return any(
            rule.effect is Effect.ALLOW and any(expression.matches(p, partition) for p in rule.partitions or ("",))
            for rule in concerned
        )

    return all(permitted(partition) for partition in partitions or ("",))


@dataclass(frozen=True)
class _Criteria:
    action: str
    topics: tuple[str, ...]
    partitions: tuple[str, ...] | None


@lru_cache(maxsize=64)
def _rules(document: bytes):
    return tuple(_each_rule(document))


def _each_rule(document: bytes):
    grant = etree.fromstring(document).find("permissions/grant")
    for rule in grant:
        if rule.tag in {"allow_rule", "deny_rule"}:
            criteria = [
                _Criteria(
                    str(item.tag),
                    tuple(topic.text for topic in item.find("topics")),
                    None if item.find("partitions") is None else tuple(p.text or "" for p in item.find("partitions")),
                )
                for item in rule
                if item.tag != "domains"
            ]
            yield rule.tag == "allow_rule", criteria


def _ranges(members: str):
    """Yield the ranges of a bracket expression: every member is one, or none is, as Keymint writes them."""
    if members.replace("_", "a").isalnum():
        return zip(members, members, strict=True)
    assert members[1::3] == "-" * (len(members) // 3), members
    return zip(members[0::3], members[2::3], strict=True)


@lru_cache(maxsize=4096)
def _compiled(pattern: str, cyclone: bool) -> re.Pattern[str]:
    """``*``, ``?`` and bracket expressions without escapes; Cyclone takes ``]`` to be in every set."""
    out = ""
    at = 0
    while at < len(pattern):
        char = pattern[at]
        if char == "[":
            end = pattern.index("]", at + 1)
            body = pattern[at + 1 : end]
            negated = body.startswith("!")
            ranges = "".join(f"\\x{ord(low):02x}-\\x{ord(high):02x}" for low, high in _ranges(body[negated:]))
            out += f"[{'^' * negated}{ranges}{chr(92) + ']' if cyclone else ''}]"
            at = end + 1
            continue
        out += ".*" if char == "*" else "." if char == "?" else re.escape(char)
        at += 1
    return re.compile(out, re.DOTALL)


def matches_any(patterns, text: str, *, cyclone: bool = False) -> bool:
    return any(_compiled(pattern, cyclone).fullmatch(text) for pattern in patterns)


def omg(document: bytes, action: str, topic: str, partitions: tuple[str, ...] = ()) -> bool:
    """Rules in order; a deny needs one partition that it is about, an allow all of them."""
    asked = partitions or ("",)
    for allowed, criteria in _rules(document):
        for item in criteria:
            if item.action != action or not matches_any(item.topics, topic):
                continue
            if allowed:
                if all(matches_any(item.partitions or ("",), each) for each in asked):
                    return True
            elif item.partitions is None or any(matches_any(item.partitions, each) for each in asked):
                return False
    return False


def cyclone(document: bytes, action: str, topic: str, partitions: tuple[str, ...] = ()) -> bool:
    """0.10: the first rule that names the topic decides whether it may be created; then the endpoint is judged."""
    rules = list(_rules(document))
    named = (
        allowed
        for allowed, criteria in rules
        for item in criteria
        if item.action != "relay" and matches_any(item.topics, topic, cyclone=True)
    )
    if not next(named, False):
        return False
    asked = partitions or ("",)
    for allowed, criteria in rules:
        for item in criteria:
            if item.action != action or not matches_any(item.topics, topic, cyclone=True):
                continue
            listed = item.partitions or ("",)
            hits = [matches_any(listed, each, cyclone=True) for each in asked]
            if (all if allowed else any)(hits):
                return allowed
    return False


def fastdds(document: bytes, action: str, topic: str, partitions: tuple[str, ...] = ()) -> bool:
    """2.9: the first rule that names the topic decides; its partitions are those of all its criteria together."""
    for allowed, criteria in _rules(document):
        same = [item for item in criteria if item.action == action]
        if not any(matches_any(item.topics, topic) for item in same):
            continue
        listed = [each for item in same for each in item.partitions or ("",)]
        return allowed and all(matches_any(listed, each) for each in partitions or ("",))
    return False
