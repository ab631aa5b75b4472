# SPDX-License-Identifier: Apache-2.0
"""Compares the decisions of a policy with those of the vendors' code on the documents compiled from it.

The names of ROS 2 on DDS are said here once more, in the simplest way, and not taken from the compiler.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from keymint_ros2_comarmor import policy_type
from keymint_ros2_dds import build_type
from keymint_ros2_dds.settings import BUILD_TYPE, DdsSettings, DomainRule, TopicProtection
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
from keymint_ros2_dds.vendors.participants import RefusedError, System

from comarmor.errors import Origin
from keymint.api import BuildOptions, CertificateSpec, DomainRange, Grant, KeySpec, Package, PolicySource, Validity

from .handmade import access_control

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import ProbeParticipant, Vendor

    import comarmor

    from .handmade import Authorities

_HERE = Origin("test")
_SERVICE_PARTS = {
    "ros_request": ("/_action/send_goal", "/_action/cancel_goal", "/_action/get_result"),
    "ros_read": ("/describe_parameters", "/get_parameters", "/get_parameter_types", "/list_parameters"),
    "ros_write": ("/set_parameters", "/set_parameters_atomically"),
}
_SERVICE_PARTS["ros_operate"] = _SERVICE_PARTS["ros_request"]
_TOPIC_PARTS = ("/_action/feedback", "/_action/status")

REQUESTS: tuple[tuple[str, str], ...] = (
    ("ros_topic", "ros_publish"),
    ("ros_topic", "ros_subscribe"),
    ("ros_service", "ros_call"),
    ("ros_service", "ros_execute"),
    ("ros_action", "ros_request"),
    ("ros_action", "ros_operate"),
    ("ros_parameter", "ros_read"),
    ("ros_parameter", "ros_write"),
)
"""Every kind and permission on ROS names that an endpoint of a node needs."""


@dataclass(frozen=True, slots=True, order=True)
class Operation:
    """An endpoint on a DDS topic."""

    direction: str
    topic: str


def operations(permission: str, name: str) -> tuple[Operation, ...]:
    """Return the endpoints that a node with the permission on the name needs (Bouncy and later)."""
    match permission:
        case "publish" | "subscribe" as direction:
            return (Operation(direction, name),)
        case "ros_publish":
            return (Operation("publish", f"rt{name}"),)
        case "ros_subscribe":
            return (Operation("subscribe", f"rt{name}"),)
        case "ros_call":
            return Operation("publish", f"rq{name}Request"), Operation("subscribe", f"rr{name}Reply")
        case "ros_execute":
            return Operation("subscribe", f"rq{name}Request"), Operation("publish", f"rr{name}Reply")
    service = "ros_execute" if permission == "ros_operate" else "ros_call"
    topic = {"ros_request": "ros_subscribe", "ros_operate": "ros_publish"}.get(permission)
    parts = [(service, name + suffix) for suffix in _SERVICE_PARTS[permission]]
    parts += [(topic, name + suffix) for suffix in _TOPIC_PARTS if topic]
    return tuple(operation for part in parts for operation in operations(*part))


def meanings(operation: Operation) -> tuple[tuple[str, str, str], ...]:
    """Return the rules of a policy that can apply to an endpoint: kind, permission and name of each."""
    direction, topic = operation.direction, operation.topic
    found = [("topic", str(direction), topic)]
    if topic.startswith("rt/"):
        found.append(("ros_topic", f"ros_{direction}", topic.removeprefix("rt")))
    for prefix, suffix, of_client in (("rq", "Request", "publish"), ("rr", "Reply", "subscribe")):
        if topic.startswith(f"{prefix}/") and topic.endswith(suffix):
            permission = "ros_call" if direction == of_client else "ros_execute"
            found.append(("ros_service", permission, topic.removeprefix(prefix).removesuffix(suffix)))
    return tuple(found)


def said_of(policy: comarmor.Policy, subject: str, operation: Operation, partitions: Sequence[str] = ()) -> bool:
    """Return the decision of the policy on an endpoint: raw and ROS rules both apply, DENY first."""
    decisions = [policy.decide(subject, *each, partitions) for each in meanings(operation)]
    denied = any(not decision.allowed and decision.rules for decision in decisions)
    return not denied and any(decision.allowed for decision in decisions)


def compiled(policy: Path, subject: str) -> tuple[str, str]:
    """Compile the rules of a subject; return its unsigned permissions and governance.

    Raises:
        KeymintError: the policy is not portable across vendors.
    """
    rules = policy_type.load([PolicySource("policy", policy, _HERE)], None).rules(subject)
    assert rules is not None
    now = datetime.now(UTC).replace(microsecond=0)
    validity = Validity(now - timedelta(days=2), now + timedelta(days=10))
    name, domains = f"CN={subject}", (DomainRange(0, 0),)
    identity = CertificateSpec(name, validity, None, "identity", "SHA256", KeySpec("ec", "SECP256R1"), (), _HERE)
    permissions = Grant("permissions", subject, name, validity, domains, rules, _HERE)
    everything = TopicProtection("topic", "*", _HERE)
    domain_rule = DomainRule(domains, (everything,), _HERE)
    governance = DdsSettings("permissions", (domain_rule,))
    package = Package(subject[1:], subject, "humble", identity, permissions, (BUILD_TYPE,), {BUILD_TYPE: governance})
    documents = build_type.build(package, BuildOptions()).documents
    return documents["permissions.xml"].decode(), documents["governance.xml"].decode()


@contextmanager
def access(authorities: Authorities, subject: str, documents: tuple[str, str]) -> Iterator[CycloneAccessControl]:
    """Sign the documents and open them with the access-control plugin of Cyclone DDS."""
    permissions, governance = documents
    with access_control(
        certificate=authorities.certificate_of(subject),
        permissions_ca=authorities.permissions.pem,
        governance=authorities.permissions.sign(governance),
        permissions=authorities.permissions.sign(permissions),
    ) as opened:
        assert opened.valid, opened.reason
        yield opened


@contextmanager
def participant(
    vendor: Vendor, authorities: Authorities, folder: Path, subject: str, documents: tuple[str, str]
) -> Iterator[ProbeParticipant | None]:
    """Sign the documents and create a participant of a vendor with them; yield None if the vendor refuses it."""
    permissions, governance = documents
    enclave = authorities.enclave(folder, name=subject, permissions=permissions, governance=governance)
    with System(vendor) as system:
        try:
            opened = system.open(enclave)
        except RefusedError:
            yield None
        else:
            yield opened


def allowed(opened: CycloneAccessControl, permission: str, name: str, partitions: Sequence[str] = ()) -> bool:
    """Tell whether the plugin allows every endpoint that the permission on the name needs."""
    needed = operations(permission, name)
    return all(opened.allows(each.direction, each.topic, partitions) for each in needed)
