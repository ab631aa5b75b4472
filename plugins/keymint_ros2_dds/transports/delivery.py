"""The deepest tier: two processes, and data that is really delivered between them, or really not.

For each endpoint of an edge another enclave is looked for that may be its other end. An endpoint that a participant of
the subject may have is put to use: the sample must arrive. One that it may not have is tried all the same, by a
participant of the subject that ignores its own permissions; then the other end is what must refuse it.

That nothing arrives is concluded from a sample that does: where the two enclaves may talk on some other topic, that
topic's endpoints are made last, and when its sample has arrived, all others have been decided about. Otherwise it is
concluded from silence.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, islice
from typing import cast

from keymint.api import Enclave, Verdict
from keymint.errors import KeymintError
from keymint.graph import Edge
from keymint_ros2_dds.decision import Variation
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports import admission
from keymint_ros2_dds.transports.enclave_model import EnclaveModel, EnclaveModels
from keymint_ros2_dds.vendors.participants import (
    DeniedError,
    Direction,
    ProbeEndpoint,
    ProbeError,
    ProbeParticipant,
    RefusedError,
    System,
    Vendor,
)

BATCH = 20
"""Edges that are decided with one pair of processes."""
DELIVERY_SECONDS = 10.0
"""How long a sample may take that is allowed."""
SILENCE_SECONDS = 3.0
"""How long nothing must arrive where no other sample shows that everything has been decided about."""
SETTLE_SECONDS = 0.3
"""How long nothing must arrive where one does."""

_OTHER_END: Mapping[str, str] = {"publish": "subscribe", "subscribe": "publish"}


@dataclass(slots=True)
class _Trial:
    """One endpoint of the subject under trial, with the enclave that is its other end."""

    endpoint: Edge
    admitted: bool
    said: str
    peer: Enclave | None
    delivered: bool = False


@dataclass(slots=True)
class _Peers:
    """Finds enclaves that may be the other end of an endpoint, by the model of the vendor."""

    models: EnclaveModels
    enclaves: Sequence[Enclave]
    model: Variation
    kept: dict[tuple[str, int], EnclaveModel] = field(default_factory=dict)

    def of(self, endpoint: Edge) -> Enclave | None:
        """Return the first enclave, by name and not the subject's own, that may be the other end."""
        wildcards = set("*?[")
        if endpoint.permission not in _OTHER_END or any(wildcards & set(p) for p in endpoint.object.partitions):
            return None  # two expressions never match each other (DDS 1.4, 2.2.3.13)
        action = _OTHER_END[endpoint.permission]
        for enclave in self.enclaves:
            if enclave.subject == endpoint.subject:
                continue
            other = Edge(enclave.subject, action, endpoint.object, endpoint.domain)
            if self._model(enclave, endpoint.domain).decide(self.model, other).allowed:
                return enclave
        return None

    def _model(self, enclave: Enclave, domain: int) -> EnclaveModel:
        key = (enclave.subject, domain)
        if key not in self.kept:
            self.kept[key] = self.models.fresh(enclave, domain)
        return self.kept[key]


def exchange(
    vendor: Vendor, model: Variation, models: EnclaveModels, enclaves: Sequence[Enclave], edges: Iterable[Edge]
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield whether data of each edge is delivered.

    Args:
        vendor: the vendor, with its probe and the library for participants that do not conform.
        model: the model of the vendor.
        models: the enclaves.
        enclaves: the same, as those that may be the other end.
        edges: grouped by subject.

    Raises:
        KeymintError: an enclave is missing, or a process of the vendor fails.
    """
    peers = _Peers(models, sorted(enclaves, key=lambda enclave: enclave.subject), model)
    for (subject, domain), group in groupby(edges, key=lambda edge: (edge.subject, edge.domain)):
        enclave = models.enclave(subject)
        while batch := list(islice(group, BATCH)):
            try:
                yield from _batch(vendor, model, models.of(subject, domain), enclave, peers, batch)
            except ProbeError as error:
                raise KeymintError(f"{subject}: {error}", code="transport-failed") from None


def _batch(
    vendor: Vendor,
    model: Variation,
    enclave_model: EnclaveModel,
    enclave: Enclave,
    peers: _Peers,
    batch: Sequence[Edge],
) -> Iterator[tuple[Edge, Verdict]]:
    trials = _admitted(vendor, enclave, peers, batch)
    with_peer: dict[str, list[_Trial]] = {}
    for trial in trials.values():
        if trial.peer is not None:
            with_peer.setdefault(trial.peer.subject, []).append(trial)
    for group in with_peer.values():
        _deliver(vendor, enclave, [trial for trial in group if trial.admitted])
        _intrude(vendor, enclave, group)
    for edge in batch:
        needed = endpoints(enclave.distro, edge)
        yield edge, admission.verdict(enclave_model, model, needed, (_answer(trials[endpoint]) for endpoint in needed))


def _admitted(vendor: Vendor, enclave: Enclave, peers: _Peers, batch: Sequence[Edge]) -> dict[Edge, _Trial]:
    """Return all endpoints of the edges with what a participant of the subject is told about them."""
    needed = dict.fromkeys(endpoint for edge in batch for endpoint in endpoints(enclave.distro, edge))
    found: dict[Edge, _Trial] = {}
    with System(vendor) as system:
        try:
            participant: ProbeParticipant | None = system.open(enclave.folder, batch[0].domain)
            refusal = ""
        except RefusedError as error:
            participant, refusal = None, f"the participant is refused: {error}"
        for endpoint in needed:
            reason = admission.unsayable(endpoint)
            if participant is None or reason:
                admitted, said = False, refusal or reason
            else:
                direction = cast("Direction", endpoint.permission)
                admitted, said = participant.ask(direction, endpoint.object.name, endpoint.object.partitions)
            found[endpoint] = _Trial(endpoint, admitted, said, None if reason else peers.of(endpoint))
    return found


def _deliver(vendor: Vendor, enclave: Enclave, trials: Sequence[_Trial]) -> None:
    """Send a sample over each endpoint between two conforming participants."""
    if not trials:
        return
    with System(vendor) as system:
        pairs = _pairs(system, enclave, trials, conforming=True)
        for trial, ends in pairs:
            trial.delivered = ends is not None and ends.arrives(DELIVERY_SECONDS)


def _intrude(vendor: Vendor, enclave: Enclave, trials: Sequence[_Trial]) -> None:
    """Try the endpoints that the subject may not have, as a participant that ignores its own permissions."""
    denied = [trial for trial in trials if not trial.admitted]
    if not denied:
        return
    with System(vendor) as system:
        shown = [trial for trial in trials if trial.admitted and trial.delivered][:1]
        pairs = _pairs(system, enclave, [*denied, *shown], conforming=False)
        known = any(ends is not None and trial.admitted and ends.arrives(DELIVERY_SECONDS) for trial, ends in pairs)
        seconds = SETTLE_SECONDS if known else SILENCE_SECONDS
        for trial, ends in pairs:
            if not trial.admitted and ends is not None:
                trial.delivered = ends.arrives(seconds)
                seconds = 0.01  # time has passed for all of them


@dataclass(frozen=True, slots=True)
class _SentSample:
    """A writer that has written a sample, and the reader that is to have it."""

    reader: ProbeEndpoint
    text: str

    def arrives(self, seconds: float) -> bool:
        """Wait until this very sample arrives; others, of another writer on the topic, are passed over."""
        while (found := self.reader.read(seconds)) is not None:
            if found == self.text:
                return True
        return False


def _pairs(
    system: System, enclave: Enclave, trials: Sequence[_Trial], *, conforming: bool
) -> list[tuple[_Trial, _SentSample | None]]:
    """Make both ends of each endpoint, in order, and write a sample; None where an end cannot be made."""
    domain, peer = trials[0].endpoint.domain, trials[0].peer
    found: list[tuple[_Trial, _SentSample | None]] = []
    try:
        other = system.open(cast("Enclave", peer).folder, domain)
        own = system.open(enclave.folder, domain, conforming=conforming)
    except RefusedError:
        return [(trial, None) for trial in trials]
    for number, trial in enumerate(trials):
        name, partitions = trial.endpoint.object.name, trial.endpoint.object.partitions
        publishes = trial.endpoint.permission == "publish"
        try:
            far = other.edge("subscribe" if publishes else "publish", name, partitions)
            near = own.edge("publish" if publishes else "subscribe", name, partitions)
        except DeniedError:
            found.append((trial, None))
            continue
        writer, reader = (near, far) if publishes else (far, near)
        text = f"{trial.endpoint.subject} {number}"
        writer.write(text)
        found.append((trial, _SentSample(reader, text)))
    return found


def _answer(trial: _Trial) -> tuple[bool, str]:
    peer = trial.peer
    if peer is None:
        ending = "no other enclave may be the other end, so that nothing was sent"
        return trial.admitted, f"it is admitted; {ending}" if trial.admitted else f"{trial.said}; {ending}"
    if trial.admitted:
        reason = f"a sample was delivered with {peer.subject}"
        return (
            trial.delivered,
            reason if trial.delivered else f"it is admitted, but no sample was delivered with {peer.subject}",
        )
    if trial.delivered:
        return True, f"its own side denies it, but {peer.subject} accepts it from a participant that ignores its policy"
    return False, f"{trial.said}; {peer.subject} refuses it as well"
