# SPDX-License-Identifier: Apache-2.0
"""Random policies on real Zenoh: hostile sessions send and subscribe on names and wildcards of all shapes.

Their own configuration restricts nothing. What arrives is what the policy allows, except what the proof names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import pytest
from keymint_ros2_zenoh.documents import json5
from keymint_ros2_zenoh.enclave_layout import ROUTER
from keymint_ros2_zenoh.keyexpr import canonical
from keymint_ros2_zenoh.proving.shared_proof import prove_shared

from comarmor.rules import Effect
from keymint.api import Package, SharedProofTask, TrustAnchor
from keymint.ir import Rule
from tests.effort import tries
from tests.plugins.keymint_ros2_zenoh.enclaves import pem, shared
from tests.plugins.keymint_ros2_zenoh.install_spaces import InstallSpace
from tests.plugins.keymint_ros2_zenoh.workspaces import package, rule, workspace

from .zenoh_network import RealNetwork, real_network

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

POLICIES = tries(4, 60)
SUBJECTS = ("/one", "/other")
NAMES = ("/a", "/b", "/ab", "/a/b", "/b/a")
EXPRESSIONS = (*NAMES, "*", "/a*", "/*b", "/a/*", "/*/a", "/a*b", "/[ab]", "/?b")
CHUNKS = ("*", "**", "a$*", "$*b", "a$*b", "a", "b")
FENCE, PASSED = "/fence", "passed"
_ROUNDS = 2
"""A message that closely follows declarations may get lost by chance."""
_OPEN = {"access_control": {"enabled": False}}


def key(name: str) -> str:
    return f"0{name}/type/hash"


def _wildcards() -> Iterator[str]:
    for count, (domain, tail) in product((1, 2), (("0", "type/hash"), ("0", "*/*"), ("*", "type/hash"))):
        for chunks in product(CHUNKS, repeat=count):
            text = canonical("/".join((domain, *chunks, tail))).text
            if "*" in text:
                yield text


WILD = tuple(dict.fromkeys((*_wildcards(), "**", "0/**")))
LITERAL = tuple(key(name) for name in NAMES)


def random_rules(random: Random) -> Iterator[Rule]:
    for _ in range(random.randint(2, 4)):
        kind, permissions = random.choice(
            (
                ("ros_topic", ("ros_publish", "ros_subscribe")),
                ("ros_topic", ("ros_publish", "ros_subscribe")),
                ("ros_service", ("ros_call", "ros_execute")),
            )
        )
        own = random.sample(permissions, random.randint(1, 2))
        expressions = random.sample(EXPRESSIONS, random.randint(1, 2))
        effect = random.choice(("ALLOW", "ALLOW", "DENY"))
        if effect == "DENY":
            expressions = [each for each in expressions if not fnmatchcase(FENCE, each)] or ["/a"]
        yield rule(effect, kind, " ".join(own), *expressions)


def random_packages(number: int) -> tuple[Package, ...]:
    """Return a workspace; in every other one both subjects may use a wildcard, and the first one is denied a name."""
    random = Random(number)
    both = "ros_publish ros_subscribe"
    rules = {subject: [rule("ALLOW", "ros_topic", both, FENCE), *random_rules(random)] for subject in SUBJECTS}
    if number % 2:
        wild = rule("ALLOW", "ros_topic", both, random.choice(("*", "/a*", "/*b", "/a*b")))
        denied = rule("DENY", "ros_topic", "ros_publish", random.choice(("/ab", "/a/b")))
        rules = {subject: [own[0], wild] for subject, own in rules.items()}
        rules[SUBJECTS[0]].append(denied)
    return workspace(*(package(*own, subject=each, name=f"CN={each}") for each, own in rules.items()))


def effect_of(rules: Iterable[Rule], permission: str, name: str) -> Effect | None:
    """Return the decision of a policy by its rules; a denial overrides."""
    found = {
        each.effect
        for each in rules
        if permission in each.permissions and any(fnmatchcase(name, pattern) for pattern in each.expressions)
    }
    return Effect.DENY if Effect.DENY in found else next(iter(found), None)


class BuiltSpace(InstallSpace):
    """An install space whose router has the configuration that a build made."""

    built: bytes = b""

    def router(self) -> dict[str, Any]:
        document: dict[str, Any] = json5.parse(self.built, ROUTER)[0]
        return document


@dataclass(frozen=True)
class Case:
    """A policy, and its files."""

    packages: Sequence[Package]
    files: Mapping[str, bytes]

    def permits(self, subject: str, permission: str, name: str) -> Effect | None:
        [own] = [each for each in self.packages if each.subject == subject]
        return effect_of(own.grant.rules.rules, permission, name)

    def exceptions(self) -> Sequence[str]:
        """Return what the proof across subjects names as an exception."""
        anchors = {
            "identity": TrustAnchor("identity_ca", "x.pem", pem("identity_ca")),
            "access": TrustAnchor("permissions_ca", "y.pem", pem("permissions_ca")),
        }
        rules = {each.subject: each.grant.rules for each in self.packages}
        task = SharedProofTask(self.packages, rules, {}, "", self.files, "", anchors, 10_000, lambda: True)
        return [each for claim in prove_shared(task) for each in claim.excepted]


def arrivals(network: RealNetwork, sender: str, receiver: str) -> set[tuple[str, str]]:
    """Return the key expressions that were sent and subscribed to, of all samples that arrived."""
    boxes = {f"{sender} {subscribed}": subscribed for subscribed in (*LITERAL, *WILD)}
    end = f"{sender} end"
    network.sessions.ask("subscribe", session=receiver, keys={**boxes, end: key(FENCE)})
    found: set[tuple[str, str]] = set()
    for number in range(_ROUNDS):
        last = f"{PASSED} {number}"
        samples = [(sent, sent) for sent in (*LITERAL, *WILD)]
        for _ in range(20):
            network.sessions.ask("put", session=sender, samples=[*samples, (key(FENCE), last)])
            arrived = network.sessions.ask("received", names=[end, *boxes], last=last, wait=0.5)
            if any(text == last for _, text in arrived[end]):
                break
        else:
            raise AssertionError("no sample on the fence arrived, so nothing is known about the others")
        found |= {(text, boxes[box]) for box, own in arrived.items() if box != end for _, text in own}
    return {(sent, subscribed) for sent, subscribed in found if not sent.startswith(PASSED)}


@pytest.mark.parametrize("number", range(POLICIES))
def test_nothing_arrives_that_the_policy_denies(number: int, tmp_path: Path) -> None:
    packages = random_packages(number)
    case = Case(packages, shared(packages))
    exceptions = case.exceptions()
    space = BuiltSpace(tmp_path / "install", dict.fromkeys(SUBJECTS, ()))
    space.built = case.files[ROUTER]
    with real_network(space) as network:
        network.router()
        one, other = (network.session(subject[1:], _OPEN) for subject in SUBJECTS)
        found = {SUBJECTS: arrivals(network, one, other), SUBJECTS[::-1]: arrivals(network, other, one)}
    circumvented = set()
    for (sender, receiver), arrived in found.items():
        for name in NAMES:
            sends, receives = (
                case.permits(sender, "ros_publish", name),
                case.permits(receiver, "ros_subscribe", name),
            )
            by_name = {subscribed for sent, subscribed in arrived if sent == key(name)}
            both = sends is receives is Effect.ALLOW
            assert (key(name) in by_name) == both, f"{sender} to {receiver} on {name}"
            assert both or not by_name, f"{sender} to {receiver} on {name}, subscribed to {by_name}"
            around = {sent for sent, subscribed in arrived if subscribed == key(name) and sent not in LITERAL}
            if sends is None:
                assert not around, f"{sender} may not send to {name}, and did by {around}"
            if receives is None:  # a sender may address a denied name and an allowed one together
                assert not around, f"{receiver} may not receive {name}, and did by {around}"
            if sends is Effect.DENY and around:
                circumvented.add(name)
                assert any(f" of {sender} " in each for each in exceptions), f"no exception names {around}"
    assert circumvented or number % 2 == 0
