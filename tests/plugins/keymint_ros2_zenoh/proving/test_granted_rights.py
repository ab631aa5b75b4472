# SPDX-License-Identifier: Apache-2.0
"""What a router's file grants comes back as rules that decide as the policy does, or is refused."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from keymint_ros2_zenoh import build_type
from keymint_ros2_zenoh.enclave_layout import ROUTER

from keymint.api import BuildOptions, DomainRange, EnclaveFiles, InstalledRights, TrustAnchors
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from tests.plugins.keymint_ros2_zenoh.lowering.policies import KIND, NAMES, policies, policy_allows, rule
from tests.plugins.keymint_ros2_zenoh.workspaces import package, workspace

SUBJECT = "/robot1/talker"


def built(*rules: Rule, **fields: object) -> bytes:
    packages = workspace(package(*rules, subject=SUBJECT, **fields))
    return build_type.build_shared(packages, BuildOptions()).documents[ROUTER]


def granted(content: bytes) -> InstalledRights:
    enclave = EnclaveFiles({}, "", TrustAnchors({}, f"CN={SUBJECT},OU=x1", "sros2"))
    found = build_type.prover.rights(enclave, SUBJECT, {ROUTER: content})
    assert found is not None
    return found


@given(policies())
def test_what_keymint_compiles_comes_back(rules: SubjectRules) -> None:
    found = granted(built(*rules.rules))
    read = SubjectRules(SUBJECT, found.rules)
    for permission, name in product(KIND, NAMES):
        assert policy_allows(read, permission, name) is policy_allows(rules, permission, name), (permission, name)
    assert {each.kind for each in found.rules} <= {*KIND.values()}


@pytest.mark.parametrize(
    "expression",
    ["/a", "/a*", "*a", "/*a", "/a/*", "/*", "/*/b", "/a*b", "/a/*/b", "/a*b/*c", "/*a*b*", "/a/b*c/*", "/*/*", "*"],
)
def test_wildcards_come_back(expression: str) -> None:
    content = built(rule("ALLOW", "ros_topic", ["ros_publish"], expression))
    rules = granted(content).rules
    assert built(*rules) == content
    assert all(each.permissions == ("ros_publish",) for each in rules)


def test_domains_come_back() -> None:
    content = built(rule("ALLOW", "ros_topic", ["ros_publish"], "/a"), domains=(DomainRange(3, 4), DomainRange(7, 7)))
    assert granted(content).domains == (DomainRange(3, 3), DomainRange(4, 4), DomainRange(7, 7))


def test_who_has_no_entry_is_granted_nothing() -> None:
    enclave = EnclaveFiles({}, "", TrustAnchors({}, "CN=/other", "sros2"))
    content = built(rule("ALLOW", "ros_topic", ["ros_publish"], "/a"))
    assert build_type.prover.rights(enclave, "/other", {ROUTER: content}) == InstalledRights((), ())
    assert build_type.prover.rights(enclave, "/other", {}) is None


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b'"0/x/*/*"', b'"0/x$*/*/*"', "no expressions of a policy match what x$* do"),
        (b'"0/x/*/*"', b'"0/x/*/*/*"', "no expressions of a policy match what x/* do"),
        (b'"0/x/*/*"', b'"0/a/**/b/*/*"', "no expressions of a policy match what a/**/b do"),
        (b'"0/x/*/*"', b'"0/x/String/*"', "no key of a ROS name"),
        (b'"0/x/*/*"', b'"*/x/*/*"', "no key of a ROS name"),
        (b'"0/x/*/*"', b'"0/x/*/*", "5/y/*/*"', "not the same in all domains"),
        (b'"default_permission": "deny"', b'"default_permission": "allow"', "not one subject decides alone"),
    ],
)
def test_what_no_policy_can_say(old: bytes, new: bytes, reason: str) -> None:
    content = built(rule("ALLOW", "ros_topic", ["ros_publish"], "/x"))
    assert old in content, content.decode()
    with pytest.raises(KeymintError) as caught:
        granted(content.replace(old, new))
    assert reason in str(caught.value)
    assert caught.value.diagnostics[0].code == "rights-unread"
