# SPDX-License-Identifier: Apache-2.0
"""Access controls of routers for tests, in the sound shape, and what can be wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from keymint_ros2_zenoh.decision import AccessModel
from keymint_ros2_zenoh.documents.configuration import AccessControl, AclPolicy, AclRule, AclSubject, Permission
from keymint_ros2_zenoh.lowering.key_rules import lower_package
from keymint_ros2_zenoh.proving.enclave_proof import prove_rights

from comarmor.errors import Origin
from keymint.api import Claim, DomainRange, EnclaveFiles, ProofTask, TrustAnchors
from keymint.ir import SubjectRules
from tests.plugins.keymint_ros2_zenoh.workspaces import package

DOMAINS = (DomainRange(0, 0),)
FILE = "zenoh/router.json5"


def control_of(subjects: Mapping[str, SubjectRules]) -> AccessControl:
    """Return the access control for the rules of subjects by their common names."""
    rules, entries, policies = [], [], []
    for name, own in subjects.items():
        lowered = lower_package(package(*own.rules, subject=own.subject, domains=DOMAINS))[0]
        ids = []
        for rule in lowered:
            ids.append(f"{name} {len(ids) + 1}")
            where = Origin(FILE, len(rules) + 10)
            rules.append(replace(rule, id=ids[-1], where=where))
        entries.append(AclSubject(name, (name,), where=Origin(FILE, 1000 + len(entries))))
        policies.append(AclPolicy(tuple(ids), (name,)))
    return AccessControl(True, Permission.DENY, tuple(rules), tuple(entries), tuple(policies), Origin(FILE, 5))


def claims_of(rules: SubjectRules, name: str, control: AccessControl, states: int) -> list[Claim]:
    """Return the claims about an enclave whose own sessions are not restricted."""
    enclave = EnclaveFiles({}, "", TrustAnchors({}, "", "sros2"))
    task = ProofTask(package(subject=name), rules, enclave, states, lambda: True)
    session = AccessModel(AccessControl(False, Permission.DENY)).of_certificate(name)
    return list(prove_rights(task, AccessModel(control).of_certificate(name), session))


def with_rules(control: AccessControl, change: Callable[[AclRule], AclRule]) -> AccessControl:
    return replace(control, rules=tuple(map(change, control.rules)))
