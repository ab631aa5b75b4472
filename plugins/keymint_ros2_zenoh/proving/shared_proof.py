# SPDX-License-Identifier: Apache-2.0
"""Prove claims across subjects: how the router knows them, and that no wildcard carries a message around a denial."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from keymint.api import Claim, Package, Proof, SharedProofTask
from keymint.errors import KeymintError
from keymint_ros2_zenoh import configuration_requirements
from keymint_ros2_zenoh.authority_roles import ACCESS
from keymint_ros2_zenoh.decision.admission import first_common_name
from keymint_ros2_zenoh.decision.message_access import LinkAccess
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.emission import common_name
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, ROUTER
from keymint_ros2_zenoh.keyexpr.key_expr import parse
from keymint_ros2_zenoh.keyexpr.key_relations import includes, intersects
from keymint_ros2_zenoh.lowering.name_keys import ADVANCED
from keymint_ros2_zenoh.messages import Flow, Message
from keymint_ros2_zenoh.proving.anchor_check import router_differences
from keymint_ros2_zenoh.proving.claims import MODEL
from keymint_ros2_zenoh.proving.enclave_proof import configuration_claim, router_access
from keymint_ros2_zenoh.proving.wildcard_leaks import Leak, Rights, leaks
from keymint_ros2_zenoh.settings import is_router

ROUTE, IDENTIFY, ADDRESS = "route", "identify", "address"
_ROUTE = "all links of the router"
_IDENTIFY = "all certificates of the workspace's authority"
_ADDRESS = "all key expressions that subjects may send, literal or not"
_SENT = (Message.PUT, Message.DELETE, Message.QUERY)
"""The messages that a router passes on to those whose rights include their key expression."""


def prove_shared(task: SharedProofTask) -> tuple[Claim, ...]:
    """Return the claims across subjects; see :meth:`keymint.api.SharedProver.prove_shared`.

    Raises:
        KeymintError: the router's file is missing, cannot be read, or does not rest on the workspace's authority.
    """
    if found := router_differences(task.shared, task.shared_folder, task.anchors[ACCESS]):
        raise KeymintError.of(found)
    file = f"{task.shared_folder}/{ROUTER}"
    configuration = read(task.shared[ROUTER], file)
    model = router_access(task.shared[ROUTER], file)
    names = {package.subject: _name(package, task.enclaves) for package in task.packages if not is_router(package)}
    links = {subject: model.of_certificate(name) for subject, name in names.items()}
    return (_route(task, configuration, file), _identify(configuration, names, file), *_address(links))


def _name(package: Package, enclaves: Mapping[str, Mapping[str, bytes]]) -> str:
    """Return the common name that an enclave shows, or will show if it is not installed."""
    pem = enclaves.get(package.subject, {}).get(CERTIFICATE)
    return common_name(package) if pem is None else first_common_name(pem)


def _route(task: SharedProofTask, configuration: Configuration, file: str) -> Claim:
    """Return the claim that the router decides on every message, and knows who sends it."""
    routers = [package for package in task.packages if is_router(package)]
    if len(routers) != 1:
        return Claim(MODEL, ROUTE, (), _ROUTE, Proof.UNKNOWN, f"the workspace has {len(routers)} packages of routers")
    found = tuple(configuration_requirements.by_itself(configuration, routers[0], file))
    expected = "the router must decide on every message, by the certificate of its sender"
    unmodelled = configuration_requirements.unmodelled_setting(configuration, router=True)
    return configuration_claim(ROUTE, routers[0].subject, _ROUTE, found, expected, unmodelled)


def _identify(configuration: Configuration, names: Mapping[str, str], file: str) -> Claim:
    """Return the claim that each enclave has the rights of one entry, and nobody else has any."""
    found = (
        *configuration_requirements.open_default(configuration, file),
        *configuration_requirements.entries(configuration),
        *configuration_requirements.holders(configuration, names, file),
    )
    expected = "each enclave must have one subject entry with its common name, and nobody else one"
    return configuration_claim(IDENTIFY, "", _IDENTIFY, found, expected)


def _address(links: Mapping[str, LinkAccess]) -> Iterator[Claim]:
    """Yield for each message the claim that no key expression carries it around a denial, except those it names."""
    for message in _SENT:
        senders = [_rights(subject, link, message, Flow.INGRESS) for subject, link in links.items()]
        receivers = [_rights(subject, link, message, Flow.EGRESS) for subject, link in links.items()]
        found = (leak for leak in leaks(senders, receivers) if not _without_answer(links[leak.sender], leak))
        excepted = tuple(dict.fromkeys(_exception(leak, message) for leak in found))
        yield Claim(MODEL, f"{ADDRESS} by {message}", (), _ADDRESS, Proof.PROVEN, excepted=excepted)


def _rights(subject: str, link: LinkAccess, message: Message, flow: Flow) -> Rights:
    entries = link.keys(message, flow)
    return Rights(
        subject,
        tuple(key for allowed, _ in entries for key in allowed),
        tuple(key for _, denied in entries for key in denied),
    )


def _without_answer(link: LinkAccess, leak: Leak) -> bool:
    """Return whether a leaking query is one for cached data, of which no answer reaches the sender."""
    chunks = leak.denied.chunks
    if ADVANCED not in chunks:
        return False
    data = parse("/".join(chunks[: chunks.index(ADVANCED)]))
    return all(
        any(includes(each, data) for each in denied) or not any(intersects(each, data) for each in allowed)
        for allowed, denied in link.keys(Message.REPLY, Flow.EGRESS)
    )


def _exception(leak: Leak, message: Message) -> str:
    """Return in words how a hostile session may get around a denial: access control cannot tell such messages apart."""
    if leak.key is None:
        return f"a {message} of {leak.sender} may reach {leak.receiver} around the denial of {leak.denied}"
    return (
        f"a {message} of {leak.sender} to {leak.key} reaches {leak.receiver}, although {leak.sender} is denied "
        f"{leak.denied}: a denial holds for names, not for wildcards that a hostile process sends"
    )
