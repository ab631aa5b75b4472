# SPDX-License-Identifier: Apache-2.0
"""The tiers *decision* and *admission*, which are one: the log of a real router about a real session of each enclave.

A session is opened with the enclave's files and declares publishers on all keys in question. The router and the session
then log their decisions for all messages on these keys, and nothing is sent. Both use the installed files, changed for
loopback as :mod:`keymint_ros2_zenoh.vendors.loopback` says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count, groupby, islice

from keymint.api import Verdict
from keymint.api.graph import Edge
from keymint.errors import KeymintError, Origin
from keymint.host.vendor_process import ProcessFailedError
from keymint_ros2_zenoh.documents.configuration import Flow
from keymint_ros2_zenoh.lowering.permissions import Operation, OperationRequest, operations
from keymint_ros2_zenoh.transports import enclave_model
from keymint_ros2_zenoh.vendors import loopback, zenoh_processes
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError, ZenohProcess, ZenohSystem

ROUTER = "router"
_ATTEMPTS = 5
"""Another program may take a free port before the router does."""
_NO_ACCESS_CONTROL: Mapping[str, object] = {"access_control": {"enabled": False}}


@contextmanager
def running_network(router: enclave_model.InstalledConfiguration, variables: Mapping[str, str]) -> Iterator[Network]:
    """Start a router, to which sessions can connect; its processes end with the context.

    Args:
        router: the router's files.
        variables: environment variables.

    Raises:
        KeymintError: Zenoh refuses the router's configuration, or a process fails.
    """
    try:
        with ZenohSystem(variables) as system:
            yield Network(router, system)
    except (ProcessFailedError, ZenohError) as error:
        raise KeymintError(str(error), code="transport-failed") from None


class Network:
    """A router, and sessions that connect to it; made by :func:`running_network`.

    Attributes:
        router: the process of the router; it logs its decisions.
        sessions: the process of all sessions; it logs the decisions of their own access control.
    """

    def __init__(self, router: enclave_model.InstalledConfiguration, system: ZenohSystem) -> None:
        self.router = system.start(log=zenoh_processes.FILTER)
        self.sessions = system.start(log=zenoh_processes.FILTER)
        self._numbers = count()
        listen = router.configuration.listen
        for attempt in range(_ATTEMPTS):
            self._ports = {loopback.port(endpoint): str(loopback.free_port()) for endpoint in listen}
            try:
                self.router.open(ROUTER, router.file, loopback.router_changes(listen, self._ports) | _paths(router))
            except ZenohError as error:
                if attempt == _ATTEMPTS - 1 or "in use" not in str(error):
                    raise KeymintError(f"Zenoh does not start the router: {error}", code="enclave-refused") from None
            else:
                return

    def open(self, model: enclave_model.ZenohEnclaveModel, *, conforming: bool = True) -> str:
        """Open a session of an enclave and return its name in commands.

        Args:
            model: the enclave.
            conforming: it uses its own access control; otherwise it is the session of an attacker, which only the
                router restrains.

        Raises:
            ZenohError: it gets no link to the router; or the model refuses the link to a host that is not this machine,
                whose name is not compared here.
        """
        name = f"session{next(self._numbers)}"
        connect = model.files.configuration.connect
        if model.refusal and not {loopback.host(each) for each in connect} <= set(loopback.LOOPBACK):
            raise ZenohError(model.refusal)
        changes = loopback.session_changes(connect, self._ports) | _paths(model.files)
        if not conforming:
            changes |= _NO_ACCESS_CONTROL
        self.sessions.open(name, model.files.file, changes)
        return name


def _paths(files: enclave_model.InstalledConfiguration) -> dict[str, object]:
    return loopback.path_changes(files.configuration.settings(), files.local)


_FENCE = "keymint/fence"
Needed = Sequence[Sequence[Operation]]
"""The operations of each of several edges."""


def logged_decisions(session: LoggedSession, needed: Needed) -> Iterable[Verdict]:
    """Return whether the router and the session allow each edge.

    Args:
        session: a session of the subject of the edges.
        needed: what the edges need.

    Raises:
        ProcessFailedError: a process fails.
    """
    session.declare(operation for each in needed for operation in each)
    return map(session.verdict, needed)


def in_sessions(
    network: Network,
    models: enclave_model.InstalledModels,
    edges: Iterable[Edge],
    size: int,
    verdicts: Callable[[LoggedSession, Needed], Iterable[Verdict]],
) -> Iterator[tuple[Edge, Verdict]]:
    """Yield verdicts on edges; an enclave whose session has no link to the router has one for all of them.

    Args:
        network: the router.
        models: the enclaves.
        edges: grouped by subject; one session at a time decides them.
        size: how many edges are decided at a time.
        verdicts: takes a session, and the operations of each edge.

    Raises:
        KeymintError: an enclave is missing.
        ProcessFailedError: a process fails.
    """
    for subject, group in groupby(edges, key=lambda edge: edge.subject):
        model = models.of(subject)
        try:
            session = LoggedSession(network, models, subject)
        except ZenohError as error:
            reason = model.refusal or f"the session has no link to the router: {error}"
            verdict = Verdict(allowed=False, reason=reason, where=Origin(str(model.files.file)))
            yield from ((edge, verdict) for edge in group)
            continue
        while batch := list(islice(group, size)):
            yield from zip(batch, verdicts(session, list(map(operations, batch))), strict=True)
        session.close()


class LoggedSession:
    """A session, and what both ends of its link decide.

    Args:
        network: the router.
        models: the enclaves.
        subject: the subject of the session.

    Attributes:
        network: the router.
        models: the enclaves.
        model: the enclave of the session.

    Raises:
        ZenohError: it gets no link to the router.
    """

    def __init__(self, network: Network, models: enclave_model.InstalledModels, subject: str) -> None:
        self.network, self.models, self.model = network, models, models.of(subject)
        self._fences = count()
        self._declared: set[str] = set()
        self._session = network.open(self.model)
        zid = network.sessions.ask("zid", session=self._session)
        router_zid = network.router.ask("zid", session=ROUTER)
        self._at_router = _Decisions(network.router, zid, self.model.router_access.watched)
        self._at_session = _Decisions(network.sessions, router_zid, self.model.session_access.watched)

    def declare(self, needed: Iterable[Operation]) -> None:
        """Let both ends decide on the keys of operations."""
        keys = dict.fromkeys(key for operation in needed for key in operation.keys)
        new = [key for key in keys if key not in self._declared]
        if not new:
            return
        self._declared.update(new)
        fence = f"{_FENCE}/{next(self._fences)}"
        self.network.sessions.ask("publishers", session=self._session, keys=[*new, fence])
        for decisions in (self._at_router, self._at_session):
            decisions.read(fence)

    def verdict(self, needed: Sequence[Operation]) -> Verdict:
        """Return the decision on an edge by its operations, which were declared: all their messages are needed."""
        return enclave_model.edge_verdict(needed, self._decide, self._decide_at_router)

    def close(self) -> None:
        """Close the session."""
        self.network.sessions.ask("close", session=self._session)

    def _decide(self, request: OperationRequest) -> Verdict:
        own = self._at_session.allows(request.message, request.flow.opposite, request.key)
        if not own:
            return self._verdict(own, "the session", request, self.model.at_session(request))
        return self._decide_at_router(request)

    def _decide_at_router(self, request: OperationRequest) -> Verdict:
        router = self._at_router.allows(request.message, request.flow, request.key)
        return self._verdict(router, "the router", request, self.model.at_router(request))

    def _verdict(self, allowed: bool, who: str, request: OperationRequest, modelled: Verdict) -> Verdict:
        """Return a verdict with the place of the rule by which the model decides the same."""
        where = modelled.where if modelled.allowed == allowed else None
        return Verdict(allowed, f"{who} {'permits' if allowed else 'denies'} {request}", where)


class _Decisions:
    """The decisions of a process about one link, from its log.

    Args:
        process: the process.
        zid: identifier of the session at the other end.
        flows: the flows of which it looks at each message.
    """

    def __init__(self, process: ZenohProcess, zid: str, flows: frozenset[Flow]) -> None:
        self._process = process
        self._zid = zid
        self._flows = flows
        self._found: dict[tuple[str, str, str], bool] = {}
        self._for_all: bool | None = None

    def read(self, fence: str) -> None:
        """Read the log up to the decisions on a fence."""
        if self._flows and self._for_all is None:
            for each in self._process.await_decisions(self._zid, fence):
                if each.message:
                    self._found[each.message, each.flow, each.key] = each.allowed
                else:
                    self._for_all = each.allowed

    def allows(self, message: str, flow: str, key: str) -> bool:
        """Return the decision about a message on a key that was declared."""
        if self._for_all is not None:
            return self._for_all
        return self._found[message, flow, key] if flow in self._flows else True
