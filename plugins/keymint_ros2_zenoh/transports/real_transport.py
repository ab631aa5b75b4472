# SPDX-License-Identifier: Apache-2.0
"""The real transport: routers and sessions of Zenoh in processes on loopback, with the installed files.

Its tier *exchange* tests whether data is delivered between two real sessions through the router.

For each operation of an edge, search for an enclave that may do the other end. If the log says that the session and the
router permit all messages of the operation, a sample must arrive, or a query must be answered, with declared publishers
and queriers as ROS nodes have. If not, a session of an attacker tries: it has the files of the enclave, ignores its own
access control, and sends without declaring anything first.

To conclude that a sample will not arrive, wait for one that does. A link keeps the order of messages, so samples that
are denied are sent before one that is not. All of it is repeated, because a message that closely follows the
declaration of its receiver may get lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, groupby

from comarmor.values import Data, replace
from keymint.api import Availability, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Edge
from keymint.host.vendor_process import VendorTransport
from keymint_ros2_zenoh.lowering.permissions import CALL, OTHER_END, PUBLISH, SUBSCRIBE, Operation
from keymint_ros2_zenoh.transports.enclave_model import NAMELESS, InstalledModels, ZenohEnclaveModel
from keymint_ros2_zenoh.transports.logged_decisions import (
    LoggedSession,
    Needed,
    in_sessions,
    logged_decisions,
    running_network,
)
from keymint_ros2_zenoh.vendors.zenoh_processes import installed_version

DECIDED, TRIED = 200, 500
"""Edges whose keys are declared at a time, and edges that are tried at a time."""
ROUNDS = 20
"""How often an allowed sample is sent until it arrives."""
ROUND_SECONDS = 0.5
"""How long a sample may take."""
SILENCE_SECONDS = 1.0
"""How long no sample must arrive, if there is no other sample to wait for."""
_A_MOMENT = 0.01
SETTLE_SECONDS = 0.2
"""How long no sample must arrive after another one has."""


class _SampleTrial(Data, frozen=False):
    """An operation of the subject under test, with the enclave that does the other end."""

    operation: Operation
    logged: Verdict
    peer: str
    delivered: bool = False


def exchange(session: LoggedSession, needed: Needed) -> Iterable[Verdict]:
    """Return whether data is delivered for each edge.

    Args:
        session: a session of the subject of the edges; each of its enclaves may do the other end.
        needed: what the edges need.

    Raises:
        KeymintError: an enclave is missing.
        ProcessFailedError: a process fails.
    """
    found = dict.fromkeys(chain.from_iterable(needed))
    session.declare(found)
    trials = {each: _SampleTrial(each, session.verdict([each]), _peer(session, each)) for each in found}
    _try(session, list(trials.values()))
    return (_verdict([trials[each] for each in own]) for own in needed)


def _peer(session: LoggedSession, operation: Operation) -> str:
    """Return the first other subject, by name, that may do the other end by the model; empty if there is none."""
    models, other = session.models, Operation(OTHER_END[operation.permission], operation.key)
    for each in sorted(models.enclaves):
        model = models.of(each)
        if model is not session.model and all(model.decide(request).allowed for request in other.requests):
            return each
    return ""


def _try(session: LoggedSession, trials: Sequence[_SampleTrial]) -> None:
    """Try operations of the same permission with the same enclave together."""
    by_run: dict[tuple[str, str], list[_SampleTrial]] = {}
    for trial in trials:
        if trial.peer:
            by_run.setdefault((trial.peer, trial.operation.permission), []).append(trial)
    silent: list[_Run] = []
    for (peer, _), group in by_run.items():
        other = session.models.of(peer)
        permitted = [trial for trial in group if trial.logged.allowed]
        denied = [trial for trial in group if not trial.logged.allowed]
        if permitted:
            _Run(session, other, permitted, conforming=True).deliver()
        if denied:
            shown = [trial for trial in permitted if trial.delivered][:1]
            run = _Run(session, other, [*denied, *shown], conforming=False)
            if shown:
                run.deliver()
            else:
                silent.append(run)
    _wait_in_silence(silent)


def _wait_in_silence(runs: Sequence[_Run]) -> None:
    """Wait for the samples of several runs together, of which none must arrive."""
    for _ in range(2):
        for run in runs:
            run.send()
        for number, run in enumerate(runs):
            run.collect(_A_MOMENT if number else SILENCE_SECONDS)
    for run in runs:
        run.close()


class _Run:
    """Two sessions that try operations of one permission, those that are denied first.

    Args:
        session: a session of the subject under test, which has others for this.
        other: the enclave that does the other end, by its own rules.
        trials: the operations.
        conforming: the subject uses its own access control, and its session behaves as a ROS node does.
    """

    def __init__(
        self, session: LoggedSession, other: ZenohEnclaveModel, trials: Sequence[_SampleTrial], *, conforming: bool
    ) -> None:
        self._process = session.network.sessions
        self._trials = trials
        self._conforming = conforming
        self._own = session.network.open(session.model, conforming=conforming)
        self._other = session.network.open(other)
        # The key of each mailbox, in the order of the trials.
        self._boxes = {self._name(trial): trial.operation.key for trial in trials}
        permission = trials[0].operation.permission
        active = permission in {PUBLISH, CALL}
        self._sender, self._receiver = (self._own, self._other) if active else (self._other, self._own)
        self._is_topic = permission in {PUBLISH, SUBSCRIBE}
        self._by_querier = conforming and not self._is_topic
        if self._is_topic:
            self._process.ask("subscribe", session=self._receiver, keys=self._boxes)
        else:
            self._process.ask("answer", session=self._receiver, keys=[*self._boxes.values()], text=self._receiver)

    def deliver(self) -> None:
        """Send until every permitted sample has arrived, and once more if there are denied ones; then end."""
        permitted = [trial for trial in self._trials if trial.logged.allowed]
        for _ in range(ROUNDS):
            self.send()
            self.collect(ROUND_SECONDS)
            if all(trial.delivered for trial in permitted):
                break
        if len(permitted) < len(self._trials):
            self.send()
            self.collect(SETTLE_SECONDS)
        self.close()

    def send(self) -> None:
        """Send everything once, the denied samples first."""
        if self._is_topic:
            samples = [(trial.operation.key, self._text(trial)) for trial in self._trials]
            self._process.ask("publish" if self._conforming else "put", session=self._sender, samples=samples)
        elif not self._by_querier:
            self._process.ask("query", session=self._sender, keys=self._boxes)

    def collect(self, seconds: float) -> None:
        """Note what has arrived when the last sample or answer has, if it is permitted, or when a time has passed."""
        if self._by_querier:
            keys = [*self._boxes.values()]
            answers = self._process.ask("queriers", session=self._sender, keys=keys, wait=seconds)
            for trial in self._trials:
                trial.delivered |= self._text(trial) in answers[trial.operation.key]
            return
        last = self._trials[-1]
        text = self._text(last) if last.logged.allowed else ""
        found = self._process.ask("received", names=[*reversed(self._boxes)], last=text, wait=seconds)
        for trial in self._trials:
            trial.delivered |= any(text == self._text(trial) for _, text in found[self._name(trial)])

    def close(self) -> None:
        """Close the sessions."""
        for session in (self._own, self._other):
            self._process.ask("close", session=session)

    def _name(self, trial: _SampleTrial) -> str:
        """Return the name of a trial's mailbox."""
        return f"{self._own} {trial.operation.permission} {trial.operation.key}"

    def _text(self, trial: _SampleTrial) -> str:
        """Return the text of a trial's sample, or of the answer to its query."""
        return self._name(trial) if self._is_topic else self._receiver


def _verdict(trials: Sequence[_SampleTrial]) -> Verdict:
    """Combine the trials of an edge: all must succeed."""
    verdicts = [_single(trial) for trial in trials] or [NAMELESS]
    return next((verdict for verdict in verdicts if not verdict.allowed), verdicts[0])


def _single(trial: _SampleTrial) -> Verdict:
    logged, peer = trial.logged, trial.peer
    if not peer:
        reason = f"{logged.reason}; no other enclave may do the other end, so nothing was sent"
        return replace(logged, reason=reason)
    if logged.allowed:
        delivered = f"data was delivered with {peer}"
        lost = f"it is permitted, but no data was delivered with {peer}"
        return Verdict(trial.delivered, delivered if trial.delivered else lost, logged.where)
    if trial.delivered:
        return Verdict(
            allowed=True, reason=f"{logged.reason}; but a session that ignores its own access control reached {peer}"
        )
    return Verdict(allowed=False, reason=f"{logged.reason}; nothing reached {peer}", where=logged.where)


class RealZenoh(VendorTransport):
    """Implements :class:`keymint.api.Transport` with the library ``eclipse-zenoh``."""

    def _installed(self) -> Availability:
        return Availability(usable=True, version=installed_version(), tiers=tuple(Tier))

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        self.usable().require(tier, "zenoh")
        models = InstalledModels(enclaves, self._environment)
        how = (TRIED, exchange) if tier is Tier.EXCHANGE else (DECIDED, logged_decisions)
        for install, group in groupby(edges, key=lambda edge: models.enclaves[edge.subject].install):
            with running_network(models.router(install), self._environment.variables) as network:
                yield from in_sessions(network, models, group, *how)
