# SPDX-License-Identifier: Apache-2.0
"""Rules for tests, and what policies and routers decide, written down without the code under test."""

from __future__ import annotations

import re
from collections.abc import Iterable

from hypothesis import strategies as st
from keymint_ros2_zenoh.documents.configuration import AclRule, Flow, Message, Permission
from keymint_ros2_zenoh.keyexpr import includes, parse

from comarmor.errors import Origin
from comarmor.rules import Effect, Rule
from keymint.ir import SubjectRules

TYPED = "std_msgs::msg::dds_::String_/RIHS01_0"
KIND = {
    "ros_publish": "ros_topic",
    "ros_subscribe": "ros_topic",
    "ros_call": "ros_service",
    "ros_execute": "ros_service",
}
EXPRESSIONS = ("/a", "/b", "/a/b", "/a*", "*", "/*/b", "/a/*", "*b", "/[ab]", "/a?b", "/[!b]", "/ab", "/*a*b")
NAMES = ("/a", "/b", "/ab", "/a/b", "/b/b", "/aa/b", "/a/a/b", "/b/a")


def rule(effect: str, kind: str, permissions: Iterable[str], *expressions: str, line: int = 1) -> Rule:
    return Rule(Effect(effect), kind, tuple(permissions), expressions, (), False, Origin("policy.xml", line))


def subject_rules(*rules: Rule) -> SubjectRules:
    return SubjectRules("/robot1/talker", rules)


@st.composite
def policies(draw: st.DrawFn) -> SubjectRules:
    """Draw the rules of a subject about topics and services."""
    rules = []
    for line in range(draw(st.integers(1, 6))):
        kind = draw(st.sampled_from(("ros_topic", "ros_service")))
        known = [permission for permission, its in KIND.items() if its == kind]
        permissions = draw(st.lists(st.sampled_from(known), min_size=1, unique=True))
        expressions = draw(st.lists(st.sampled_from(EXPRESSIONS), min_size=1, max_size=2, unique=True))
        rules.append(rule(draw(st.sampled_from(list(Effect))), kind, permissions, *expressions, line=line + 1))
    return subject_rules(*rules)


def _regex(expression: str) -> str:
    return re.sub(r"\*|\?", lambda found: ".*" if found[0] == "*" else ".", expression).replace("[!", "[^")


def matched(rules: SubjectRules, effect: Effect, permission: str, name: str) -> bool:
    """Return whether a rule of an effect matches a topic or service."""
    return any(
        each.effect is effect and permission in each.permissions
        and any(re.fullmatch(_regex(expression), name) for expression in each.expressions)
        for each in rules.rules
    )  # fmt: skip


def policy_allows(rules: SubjectRules, permission: str, name: str) -> bool:
    return matched(rules, Effect.ALLOW, permission, name) and not matched(rules, Effect.DENY, permission, name)


def router_permits(rules: Iterable[AclRule], message: Message, flow: Flow, key: str) -> bool:
    """Decide as a router does by the rules of one subject, whose default is to deny."""
    including = {
        each.permission
        for each in rules
        if message in each.messages and flow in each.flows
        and any(includes(parse(expression), parse(key)) for expression in each.key_exprs)
    }  # fmt: skip
    return including == {Permission.ALLOW}
