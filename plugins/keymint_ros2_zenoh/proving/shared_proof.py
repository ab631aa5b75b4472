# SPDX-License-Identifier: Apache-2.0
"""Prove claims across subjects: how the router knows them, and that no wildcard carries a message around a denial.

A denial hides the keys that it includes. A sender that may also send a wider key expression can address the denied name
with it, and a receiver gets the message if its rights include that expression too. The smallest such expressions are
the denied one with one ``$*`` or ``**`` inserted. So for a denied name without wildcards their absence is a proof;
otherwise the answer may be unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain

from comarmor.values import Data
from keymint.api import Claim, Package, Proof, SharedProofTask
from keymint.errors import require_none
from keymint_ros2_zenoh import keyexpr
from keymint_ros2_zenoh.decision import LinkAccess, first_common_name
from keymint_ros2_zenoh.documents.configuration import Configuration, Flow, Message
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, ROUTER
from keymint_ros2_zenoh.examine import configurations
from keymint_ros2_zenoh.examine.enclaves import router_differences
from keymint_ros2_zenoh.identities import common_name, enclaves_of
from keymint_ros2_zenoh.lowering.permissions import ADVANCED, TYPE_AND_HASH
from keymint_ros2_zenoh.proving.enclave_proof import IDENTIFY, MODEL, ROUTE, configuration_claim, router_access
from keymint_ros2_zenoh.settings import ACCESS, is_router


class Rights(Data):
    """What a subject may send, or receive, of one message.

    Attributes:
        subject: the subject.
        allowed: key expressions that are allowed.
        denied: key expressions that are denied.
    """

    subject: str
    allowed: tuple[keyexpr.KeyExpr, ...]
    denied: tuple[keyexpr.KeyExpr, ...]


class Leak(Data):
    """A way around a denial.

    Attributes:
        sender: who is denied.
        receiver: who receives.
        denied: the denied key expression.
        key: the key expression that carries the message; None if it is not known whether there is one.
    """

    sender: str
    receiver: str
    denied: keyexpr.KeyExpr
    key: keyexpr.KeyExpr | None


_Groups = dict[tuple[tuple[keyexpr.KeyExpr, ...], tuple[keyexpr.KeyExpr, ...]], list[str]]
"""Subjects by the key expressions with wildcards that they may receive, and those that they are denied: many agree."""


def leaks(senders: Iterable[Rights], receivers: Sequence[Rights]) -> Iterator[Leak]:
    """Yield at most one leak for each denied key expression of a sender: the first with a known key, else the first."""
    groups: _Groups = {}
    for each in receivers:
        if received := tuple(allowed for allowed in each.allowed if not allowed.is_literal):
            groups.setdefault((received, each.denied), []).append(each.subject)
    for sender in senders:
        wild = [each for each in sender.allowed if not each.is_literal]
        for denied in sender.denied:
            around = [each for each in wild if keyexpr.intersects(each, denied) and not keyexpr.includes(denied, each)]
            if not around:
                continue
            found = _past(sender, denied, around, groups)
            first = next(found, None)
            if first is not None:
                yield next((leak for leak in chain((first,), found) if leak.key is not None), first)


def _past(sender: Rights, denied: keyexpr.KeyExpr, around: list[keyexpr.KeyExpr], groups: _Groups) -> Iterator[Leak]:
    """Yield the leaks past a denied key expression, one for each right of each group."""
    sent = [key for key in (*wider(denied), *around) if any(keyexpr.includes(each, key) for each in around)]
    for (allowed, hidden), subjects in groups.items():
        receiver = next((subject for subject in subjects if subject != sender.subject), None)
        for right in allowed if receiver else ():
            if not keyexpr.intersects(right, denied) or keyexpr.includes(denied, right):
                continue
            fitting = [key for key in sent if keyexpr.includes(right, key)]
            fitting += [right] * any(keyexpr.includes(each, right) for each in around)
            denials = (*sender.denied, *hidden)
            key = next((key for key in fitting if not any(keyexpr.includes(each, key) for each in denials)), None)
            meeting = any(keyexpr.intersects(each, right) for each in around)
            if key is not None or fitting or (meeting and not _is_plain(denied)):
                yield Leak(sender.subject, str(receiver), denied, key)


def _is_plain(denied: keyexpr.KeyExpr) -> bool:
    """Return whether only type and hash of a denied key expression are open, and what follows a verbatim chunk."""
    chunks = denied.chunks
    if len(chunks) > 1 and chunks[-2].startswith(keyexpr.VERBATIM):
        chunks = chunks[:-2]
    return not any("*" in chunk for chunk in chunks[: -len(TYPE_AND_HASH)])


@lru_cache(maxsize=1 << 12)
def wider(denied: keyexpr.KeyExpr) -> tuple[keyexpr.KeyExpr, ...]:
    """Return a key expression with one ``$*`` or ``**`` inserted, at each place where this makes a wider one."""
    found: dict[keyexpr.KeyExpr, None] = {}
    chunks = denied.chunks
    for at, chunk in enumerate(chunks):
        if chunk in (keyexpr.ANY_CHUNK, keyexpr.ANY_CHUNKS) or chunk.startswith(keyexpr.VERBATIM):
            continue
        for split in range(len(chunk) + 1):
            with suppress(keyexpr.KeyExprError):  # within a "$*"
                inserted = f"{chunk[:split]}{keyexpr.ANY_CHARACTERS}{chunk[split:]}"
                found[keyexpr.of_chunks((*chunks[:at], inserted, *chunks[at + 1 :]))] = None
    for at in range(len(chunks) + 1):
        found[keyexpr.of_chunks((*chunks[:at], keyexpr.ANY_CHUNKS, *chunks[at:]))] = None
    return tuple(each for each in found if not keyexpr.includes(denied, each))


ADDRESS = "address"
_ADDRESS = "all key expressions that subjects may send, literal or not"
_SENT = (Message.PUT, Message.DELETE, Message.QUERY)
"""The messages that a router passes on to those whose rights include their key expression."""


def prove_shared(task: SharedProofTask) -> tuple[Claim, ...]:
    """Return the claims across subjects; see :meth:`keymint.api.BuildType.prove_shared`.

    Raises:
        KeymintError: the router's file is missing, cannot be read, or does not rest on the workspace's authority.
    """
    require_none(router_differences(task.shared, task.shared_folder, task.anchors[ACCESS]))
    file = f"{task.shared_folder}/{ROUTER}"
    configuration = read(task.shared[ROUTER], file)
    model = router_access(task.shared[ROUTER], file)
    names: dict[str, str] = {}  # the common name that each enclave shows, or will show if it is not installed
    for package in enclaves_of(task.packages):
        pem = task.enclaves.get(package.subject, {}).get(CERTIFICATE)
        names[package.subject] = common_name(package) if pem is None else first_common_name(pem)
    identified = (
        *configurations.open_default(configuration),
        *configurations.entries(configuration),
        *configurations.holders(configuration, names),
    )
    links = {subject: model.of_certificate(name) for subject, name in names.items()}
    identify = configuration_claim(IDENTIFY, "", identified)
    return (_route(task.packages, configuration), identify, *_address(links))


def _route(packages: Iterable[Package], configuration: Configuration) -> Claim:
    """Return the claim that the router decides on every message, and knows who sends it."""
    routers = [package for package in packages if is_router(package)]
    if len(routers) != 1:
        return configuration_claim(ROUTE, "", (), f"the workspace has {len(routers)} packages of routers")
    found = tuple(configurations.by_itself(configuration, routers[0]))
    return configuration_claim(ROUTE, routers[0].subject, found, configurations.unmodelled_setting(configuration, True))


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
    data = keyexpr.parse("/".join(chunks[: chunks.index(ADVANCED)]))
    return all(
        any(keyexpr.includes(each, data) for each in denied)
        or not any(keyexpr.intersects(each, data) for each in allowed)
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
