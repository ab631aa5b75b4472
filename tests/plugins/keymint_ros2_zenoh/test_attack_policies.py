# SPDX-License-Identifier: Apache-2.0
"""Random policies, compiled, and judged by evaluators that share nothing with the compiler, the model and the proofs.

The router's file is read as plain JSON, and its key expressions become regular expressions. The policy is read with
the system's own ``fnmatch``. What a permission needs is written by hand from measurements.
"""

from __future__ import annotations

import ctypes
import json
import re
from functools import cache
from itertools import product
from random import Random
from typing import Any

import pytest
from keymint_ros2_zenoh import build_type
from keymint_ros2_zenoh.enclave_layout import ROUTER

from comarmor.rules import parts
from keymint.api import BuildOptions, DomainRange
from keymint.ir import Rule
from tests.effort import tries
from tests.plugins.keymint_ros2_zenoh.install_spaces import NEEDED
from tests.plugins.keymint_ros2_zenoh.workspaces import package, rule, workspace

POLICIES = tries(8, 300)
SUBJECTS = {"/a": (0,), "/a/b": (0, 1), "/ab": (1,)}
SEGMENTS = ("a", "b", "ab", "_a", "A", "a1")
NAMES = tuple("/" + "/".join(each) for count in (1, 2) for each in product(SEGMENTS, repeat=count))
PATTERNS = (
    "*",
    "/*",
    "/a*",
    "*a",
    "*/a",
    "/*b",
    "/a/*",
    "/*/*",
    "/a*b",
    "/?",
    "/[ab]",
    "/[!a-z]*",
    "/a[/1]*",
    "/?/b",
    "*_*",
)
SUFFIXES = ("", "/_action/send_goal", "/_action/feedback", "/get_parameters", "/set_parameters")
KINDS = {
    "ros_topic": ("ros_publish", "ros_subscribe"),
    "ros_service": ("ros_call", "ros_execute"),
    "ros_action": ("ros_request", "ros_operate"),
    "ros_parameter": ("ros_read", "ros_write"),
}  # fmt: skip
ADVANCED = "/@adv/pub/1234/5/_"
NO_RIGHT = ("delete", "liveliness_query")
"""Messages that no permission needs on the keys of a name."""
SHARED = "reply"
"""The message that publishing shares with executing, and subscribing with calling: no right where no query arrives."""

_libc = ctypes.CDLL(None)


@cache
def matches(pattern: str, name: str) -> bool:
    return bool(_libc.fnmatch(pattern.encode(), name.encode(), 0) == 0)


@cache
def expression(key_expr: str) -> re.Pattern[str]:
    """Return a regular expression of the literal keys that a key expression includes, each with a ``/`` behind it."""

    def of(chunk: str) -> str:
        if chunk == "**":
            return "(?:(?!@)[^/]+/)*"
        text = "[^/]*".join(map(re.escape, chunk.split("$*")))
        return "(?!@)[^/]+/" if chunk == "*" else f"(?!@){text}/" if chunk.startswith("$*") else f"{text}/"

    return re.compile("".join(map(of, key_expr.split("/"))))


class Router:
    """Decides by a router's file."""

    def __init__(self, content: bytes) -> None:
        document = json.loads(re.sub(r"^//.*$", "", content.decode(), flags=re.MULTILINE))
        self._control = document["access_control"]
        assert self._control["enabled"]
        assert self._control["default_permission"] == "deny"

    def rules(self, common_name: str) -> list[dict[str, Any]]:
        control = self._control
        [own] = [each["id"] for each in control["subjects"] if each["cert_common_names"] == [common_name]]
        ids = {rule for policy in control["policies"] if own in policy["subjects"] for rule in policy["rules"]}
        return [each for each in control["rules"] if each["id"] in ids]

    def permits(self, common_name: str, message: str, flow: str, key: str) -> bool:
        found = {
            each["permission"]
            for each in self.rules(common_name)
            if message in each["messages"] and flow in each["flows"]
            if any(expression(key_expr).fullmatch(f"{key}/") for key_expr in each["key_exprs"])
        }
        return found == {"allow"}


def allowed(rules: list[Rule], permission: str, name: str) -> bool:
    """Return the decision of a policy; a denial overrides."""
    effects = {
        rule.effect.value
        for rule in rules
        for own in rule.permissions
        for _, part, suffix in parts(rule.kind, own)
        if part == permission and name.endswith(suffix)
        if any(matches(pattern, name.removesuffix(suffix)) for pattern in rule.expressions)
    }
    return effects == {"ALLOW"}


def random_rules(random: Random) -> list[Rule]:
    found = []
    for _ in range(random.randint(1, 5)):
        kind = random.choice(("ros_topic", "ros_topic", *KINDS))
        permissions = random.sample(KINDS[kind], random.randint(1, 2))
        expressions = random.choices((*PATTERNS, *NAMES[:12]), k=random.randint(1, 2))
        found.append(rule(random.choice(("ALLOW", "ALLOW", "DENY")), kind, " ".join(permissions), *expressions))
    return found


@pytest.mark.parametrize("number", range(POLICIES))
def test_the_router_permits_what_the_policy_allows_and_nothing_else(number: int) -> None:
    random = Random(number)
    policy = {subject: random_rules(random) for subject in SUBJECTS}
    domains = {subject: tuple(DomainRange(each, each) for each in ids) for subject, ids in SUBJECTS.items()}
    packages = workspace(
        *(
            package(*rules, subject=subject, name=f"CN={subject}", domains=domains[subject])
            for subject, rules in policy.items()
        )
    )
    router = Router(build_type.build_shared(packages, BuildOptions()).documents[ROUTER])
    for subject, rules in policy.items():
        for name, suffix in product(random.sample(NAMES, 14), SUFFIXES):
            domain = random.randint(0, 2)
            check(router, subject, rules, domain, name + suffix)


def check(router: Router, subject: str, rules: list[Rule], domain: int, name: str) -> None:
    key = f"{domain}{name}/type/hash"
    needed: dict[tuple[str, str, str], set[str]] = {}
    for permission, slots in NEEDED.items():
        for messages, flows, suffix in slots:
            for message, flow in product(messages, flows):
                needed.setdefault((message, flow, ADVANCED if suffix else ""), set()).add(f"ros_{permission}")
    for message in NO_RIGHT:
        needed |= {(message, flow, suffix): set() for flow in ("ingress", "egress") for suffix in ("", ADVANCED)}
    for (message, flow, suffix), users in needed.items():
        right = domain in SUBJECTS[subject] and any(allowed(rules, each, name) for each in users)
        permitted = router.permits(subject, message, flow, key + suffix)
        shared = message == SHARED and permitted and len(users) > 1
        assert permitted == right or shared, f"{subject}: {message} {flow} on {key}{suffix} is {permitted}"
