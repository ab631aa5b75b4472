# SPDX-License-Identifier: Apache-2.0
"""Try what participants of a real vendor may do: which endpoints are admitted, and whether data is delivered.

Admission asks a real participant in its own process, or whatever decides, about endpoints.

The tier *exchange* tests whether data is delivered between two processes. For each endpoint of an edge, search for an
enclave that may be its other end. If a participant of the subject may have the endpoint, a sample must arrive. If not,
a participant of the subject that ignores its own permissions creates it; then the other end must refuse it.

To conclude that a sample will not arrive, wait for one that does: if the two enclaves may communicate on another topic,
its endpoints are created last, and when its sample arrives, all others have been decided. Otherwise wait for a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from itertools import groupby, islice, repeat
from typing import cast

from comarmor.values import Data, replace
from keymint.api import InstalledEnclave, Verdict
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint.host.vendor_process import ProcessFailedError
from keymint_ros2_dds.enclave_layout import reads_revocations
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports import enclave_files
from keymint_ros2_dds.transports.enclave_model import EnclaveModels
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
from keymint_ros2_dds.vendors.participants import (
    CycloneDDS,
    DeniedError,
    ProbeParticipant,
    RefusedError,
    System,
    Vendor,
)


def name_defect(endpoint: Edge) -> str:
    """Return why no participant can create an endpoint of this name, or an empty text."""
    if not "".join((endpoint.object.name, *endpoint.object.partitions)).isprintable():
        return "the name has a character that no DDS topic has"
    return "" if endpoint.object.name else "no DDS topic has an empty name"


@contextmanager
def participants(vendor: Vendor, subject: str) -> Iterator[System]:
    """Open a system of participants, which tests what a subject may do.

    Raises:
        KeymintError: a process of the vendor fails.
    """
    try:
        with System(vendor) as system:
            yield system
    except ProcessFailedError as error:
        raise KeymintError(f"{subject}: {error}", code="transport-failed") from None


def open_participant(
    system: System, enclave: InstalledEnclave, domain: int, *, conforming: bool = True
) -> ProbeParticipant:
    """Return a participant of an enclave; see :meth:`System.open`.

    Raises:
        RefusedError: the vendor refuses it, or its process would crash.
    """
    if isinstance(system.vendor, CycloneDDS):
        with suppress(KeymintError):  # what Keymint cannot read, the vendor judges
            if crash := enclave_files.crash(enclave_files.unverified_permissions(enclave.folder)):
                raise RefusedError(crash)
    revocations = reads_revocations(enclave.distro)
    return system.open(enclave.folder, domain, conforming=conforming, revocations=revocations)


@contextmanager
def participant(vendor: Vendor, models: EnclaveModels, subject: str, domain: int) -> Iterator[ProbeParticipant | str]:
    """Open a real participant of an enclave in a process of its own, or tell why it is refused; see :data:`Opener`.

    Raises:
        KeymintError: the enclave is missing, or a process of the vendor fails.
    """
    enclave = models.enclaves[subject]
    enclave_files.refuse_unusable_key(enclave)
    with participants(vendor, subject) as system:
        try:
            opened: ProbeParticipant | str = open_participant(system, enclave, domain)
        except RefusedError as error:
            opened = f"the participant is refused: {error}"
        yield opened


Opener = Callable[[EnclaveModels, str, int], AbstractContextManager[ProbeParticipant | CycloneAccessControl | str]]
"""Opens the enclave of a subject in a domain, to ask it about endpoints; a text says why the vendor refuses it."""


def edge_verdicts(opener: Opener, models: EnclaveModels, edges: Iterable[Edge]) -> Iterator[tuple[Edge, Verdict]]:
    """Yield whether a vendor allows each edge; the enclaves are opened one at a time.

    Args:
        opener: opens an enclave.
        models: the enclaves.
        edges: grouped by subject.

    Raises:
        KeymintError: an enclave is missing, or the vendor's process fails.
    """
    for (subject, domain), group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
        enclave, enclave_model = models.enclaves[subject], models.of(subject, domain)
        with opener(models, subject, domain) as opened:
            for edge in group:
                if isinstance(opened, str):
                    yield edge, Verdict(allowed=False, reason=opened, where=enclave_model.place())
                else:
                    needed = endpoints(enclave.distro, edge)
                    yield edge, enclave_model.verdict(models.variation, needed, answers(opened, needed))


def answers(vendor: ProbeParticipant | CycloneAccessControl, needed: Iterable[Edge]) -> Iterator[tuple[bool, str]]:
    """Yield whether a vendor admits each endpoint, and why not."""
    for endpoint in needed:
        reason, topic = name_defect(endpoint), endpoint.object
        yield (False, reason) if reason else vendor.ask(endpoint.permission, topic.name, topic.partitions)


BATCH = 20
"""Number of edges per pair of processes."""
DELIVERY_SECONDS = 10.0
"""How long an allowed sample may take."""
SILENCE_SECONDS = 3.0
"""How long no sample must arrive, if there is no other sample to wait for."""
SETTLE_SECONDS = 0.3
"""How long no sample must arrive after another one has."""

_OTHER_END: Mapping[str, str] = {"publish": "subscribe", "subscribe": "publish"}


class _Trial(Data, frozen=False):
    """An endpoint of the subject under test, with the enclave of its other end."""

    endpoint: Edge
    admitted: bool
    answer: str
    peer: InstalledEnclave | None
    delivered: bool = False


def exchange(vendor: Vendor, models: EnclaveModels, edges: Iterable[Edge]) -> Iterator[tuple[Edge, Verdict]]:
    """Yield whether data is delivered for each edge.

    Args:
        vendor: the vendor, with its probe and the library for participants that do not conform.
        models: the enclaves; each may be the other end.
        edges: grouped by subject.

    Raises:
        KeymintError: an enclave is missing, or a process of the vendor fails.
    """
    for _, group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
        while batch := list(islice(group, BATCH)):
            yield from _batch(vendor, models, batch)


def _batch(vendor: Vendor, models: EnclaveModels, batch: Sequence[Edge]) -> Iterator[tuple[Edge, Verdict]]:
    subject, domain = batch[0].subject, batch[0].domain
    enclave, enclave_model = models.enclaves[subject], models.of(subject, domain)
    all_needed = dict.fromkeys(endpoint for edge in batch for endpoint in endpoints(enclave.distro, edge))
    with participant(vendor, models, subject, domain) as opened:
        admissions = repeat((False, opened)) if isinstance(opened, str) else answers(opened, all_needed)
        trials = {
            endpoint: _Trial(endpoint, *answer, _peer(endpoint, models))
            for endpoint, answer in zip(all_needed, admissions, strict=False)
        }
    with_peer: dict[str, list[_Trial]] = {}
    for trial in trials.values():
        if trial.peer is not None:
            with_peer.setdefault(trial.peer.subject, []).append(trial)
    for group in with_peer.values():
        _try(vendor, enclave, group)
    for edge in batch:
        needed = endpoints(enclave.distro, edge)
        yield edge, enclave_model.verdict(models.variation, needed, (_answer(trials[each]) for each in needed))


def _peer(endpoint: Edge, models: EnclaveModels) -> InstalledEnclave | None:
    """Return the first other enclave, by name, that may be the other end by the model of the vendor.

    One that refuses the subject in the handshake, or is refused by it, is taken if there is no other.
    """
    wildcards = set("*?[")
    if name_defect(endpoint) or endpoint.permission not in _OTHER_END:
        return None
    if any(wildcards & set(partition) for partition in endpoint.object.partitions):
        return None  # two expressions never match each other (DDS 1.4, 2.2.3.13)
    own, stranger = models.of(endpoint.subject, endpoint.domain), None
    for subject in sorted(models.enclaves.keys() - {endpoint.subject}):
        other = replace(endpoint, subject=subject, permission=_OTHER_END[endpoint.permission])
        peer = models.of(subject, endpoint.domain)
        if peer.decide(models.variation, other).allowed:
            if not peer.refuses(own, models.variation) and not own.refuses(peer, models.variation):
                return models.enclaves[subject]
            stranger = stranger or models.enclaves[subject]
    return stranger


def _try(vendor: Vendor, enclave: InstalledEnclave, trials: Sequence[_Trial]) -> None:
    """Try endpoints with the same peer.

    Over each admitted one send a sample between two conforming participants. Then try the denied ones, with a
    participant that ignores its own permissions.
    """
    admitted = [trial for trial in trials if trial.admitted]
    denied = [trial for trial in trials if not trial.admitted]
    if admitted:
        with participants(vendor, enclave.subject) as system:
            for trial, arrives in _pairs(system, enclave, admitted, conforming=True):
                trial.delivered = arrives(DELIVERY_SECONDS)
    if denied:
        with participants(vendor, enclave.subject) as system:
            shown = [trial for trial in admitted if trial.delivered][:1]
            pairs = _pairs(system, enclave, [*denied, *shown], conforming=False)
            known = any(trial.admitted and arrives(DELIVERY_SECONDS) for trial, arrives in pairs)
            seconds = SETTLE_SECONDS if known else SILENCE_SECONDS
            for trial, arrives in pairs:
                if not trial.admitted:
                    trial.delivered = arrives(seconds)
                    seconds = 0.01  # time has passed for all of them


_Arrives = Callable[[float], bool]
"""Waits some seconds until a sample that was written arrives."""


def _pairs(
    system: System, enclave: InstalledEnclave, trials: Sequence[_Trial], *, conforming: bool
) -> list[tuple[_Trial, _Arrives]]:
    """Create both ends of each endpoint, in order, and write a sample; an endpoint is left out if an end is refused."""
    domain, peer = trials[0].endpoint.domain, cast("InstalledEnclave", trials[0].peer)
    pairs: list[tuple[_Trial, _Arrives]] = []
    try:
        other = open_participant(system, peer, domain)
        own = open_participant(system, enclave, domain, conforming=conforming)
    except RefusedError:
        return pairs
    for number, trial in enumerate(trials):
        name, partitions = trial.endpoint.object.name, trial.endpoint.object.partitions
        permission, text = trial.endpoint.permission, f"{trial.endpoint.subject} {number}"
        with suppress(DeniedError):
            far = other.edge(_OTHER_END[permission], name, partitions)
            near = own.edge(permission, name, partitions)
            writer, reader = (near, far) if permission == "publish" else (far, near)
            writer.write(text)
            pairs.append((trial, partial(reader.receives, text)))
    return pairs


def _answer(trial: _Trial) -> tuple[bool, str]:
    peer = trial.peer
    if peer is None:
        ending = "no other enclave may be the other end, so nothing was sent"
        return trial.admitted, f"{'it is admitted' if trial.admitted else trial.answer}; {ending}"
    if trial.admitted:
        sample = "a sample" if trial.delivered else "it is admitted, but no sample"
        return trial.delivered, f"{sample} was delivered with {peer.subject}"
    if trial.delivered:
        return True, f"its own side denies it, but {peer.subject} accepts it from a participant that ignores its policy"
    return False, f"{trial.answer}; {peer.subject} refuses it as well"
