# SPDX-License-Identifier: Apache-2.0
"""Installed enclaves as the model sees them, and the simulated transport that gives its decisions.

Both ends of a link decide: the router, and the session's own access control. Configurations name certificates and keys
by absolute paths on the robot. Here they are looked for in the install space or its copy: at the longest end of the
path that exists there. So a configuration that names the files of another enclave, or none, is read as it stands.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from comarmor.values import Data
from keymint.api import Availability, Environment, InstalledEnclave, Tier, Transport, Verdict
from keymint.api.graph import Edge
from keymint.api.transports import EnclavesBySubject, installed_file
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates
from keymint_ros2_zenoh import decision
from keymint_ros2_zenoh.decision import AccessModel, Link
from keymint_ros2_zenoh.documents import configuration_reader as documents
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.enclave_layout import ROUTER, SESSION
from keymint_ros2_zenoh.keyexpr import ANY_CHARACTERS, ANY_CHUNKS
from keymint_ros2_zenoh.lowering.permissions import TYPE_AND_HASH, Operation, OperationRequest, operations
from keymint_ros2_zenoh.vendors import loopback


class InstalledConfiguration(Data):
    """An installed configuration and its certificates.

    Attributes:
        file: its absolute path.
        install: the install space that it belongs to.
        configuration: what it says.
        access: the decisions of its access control.
    """

    file: Path
    install: Path
    configuration: Configuration
    access: AccessModel

    def local(self, path: str) -> Path | None:
        """Return where a file that the configuration names is in this install space; None if it is not there."""
        names = PurePosixPath(path).parts[1:]
        candidates = (self.install.joinpath(*names[start:]) for start in range(len(names)))
        return next((each for each in candidates if each.is_file()), None)

    def content(self, path: str) -> bytes:
        """Return a file that the configuration names.

        Raises:
            KeymintError: it is not in the install space, or cannot be read.
        """
        return installed_file(self._there(path))

    def _there(self, path: str) -> Path:
        found = self.local(path)
        if found is not None:
            return found
        missing = "does not name the certificates and keys that it needs"
        if path:
            missing = f"names {path!r}, which is not in the install space"
        where, help_ = Origin(str(self.file)), "run 'keymint install'"
        raise KeymintError(f"{self.file.name} {missing}", where=where, help=help_, code="enclave-file")

    def common_name(self, path: str) -> str:
        """Return the common name by which the other side knows a certificate that the configuration names.

        Raises:
            KeymintError: it cannot be read.
        """
        found = self._there(path)
        return decision.common_name(certificates.load_bundle(installed_file(found), Origin(str(found)))[0])


def configuration(file: Path, install: Path, environment: Environment) -> InstalledConfiguration:
    """Return the configuration of a session, or of the router; one that was read before in this run is not read again.

    Args:
        file: its absolute path.
        install: the install space that it belongs to.
        environment: what was read before.

    Raises:
        KeymintError: it cannot be read, or Zenoh would refuse it.
    """
    content = installed_file(file)
    digest = hashlib.sha256(f"zenoh {file}\n".encode() + content).digest()
    found = environment.opened.get(digest)
    if not isinstance(found, InstalledConfiguration):
        read = documents.read(content, str(file))
        access = AccessModel(read.access_control)
        found = environment.opened[digest] = InstalledConfiguration(file, install, read, access)
    return found


def installed_names(enclave: InstalledEnclave) -> tuple[str, ...]:
    """Return expressions of names like those in the router's rights; see :class:`keymint.api.BuildType`."""
    try:
        content = installed_file(enclave.install / ROUTER)
        rules = documents.read(content, ROUTER).access_control.rules
    except KeymintError:
        return ()
    return tuple(dict.fromkeys(_name(key) for rule in rules for key in rule.key_exprs if "@" not in key))


def _name(key: str) -> str:
    """Return an expression of the names in the keys that a key expression includes, or of all names."""
    _, *name = key.replace(ANY_CHUNKS, "*").replace(ANY_CHARACTERS, "*").split("/")
    if ANY_CHUNKS in key.split("/")[-len(TYPE_AND_HASH) :]:
        return f"/{'/'.join(name).rstrip('/*')}*"
    return f"/{'/'.join(name[: -len(TYPE_AND_HASH)])}"


NAMELESS = Verdict(allowed=False, reason="no key of Zenoh can have this name")


class ZenohEnclaveModel:
    """Decides about the messages of one enclave.

    Args:
        enclave: the enclave.
        router: the router that it connects to.
        environment: the clock, and what was read before in this run.

    Attributes:
        files: the configuration of its session.
        refusal: why there is no link between its session and the router; empty if there is one.
        router_access: the router's decisions on its link.
        session_access: those of its own access control.

    Raises:
        KeymintError: a file cannot be read.
    """

    def __init__(self, enclave: InstalledEnclave, router: InstalledConfiguration, environment: Environment) -> None:
        self.files = configuration(enclave.folder / SESSION, enclave.install, environment)
        own_name = self.files.common_name(self.files.configuration.connect_certificate)
        others_name = router.common_name(router.configuration.listen_certificate)
        self.refusal = _refusal(self.files, router, environment)
        self._router_file, self._session_file = str(router.file), str(self.files.file)
        # Without mutual authentication a router asks for no certificate, and knows nobody by name.
        known = own_name if router.configuration.mutual else ""
        self.router_access = router.access.on(Link(known, interface="lo", protocol="tls"))
        self.session_access = self.files.access.on(Link(others_name, interface="lo", protocol="tls"))

    def at_router(self, request: OperationRequest) -> Verdict:
        """Return what the router decides about a message."""
        return self.router_access.decide(request.message, request.flow, request.key)

    def at_session(self, request: OperationRequest) -> Verdict:
        """Return what the session's own access control decides about it."""
        return self.session_access.decide(request.message, request.flow.opposite, request.key)

    def decide(self, request: OperationRequest) -> Verdict:
        """Return the decision on a message, with the place that decided: the router's if both allow."""
        own = self.at_session(request)
        if self.refusal or own.allowed:
            return self.decide_at_router(request)
        return _verdict(request, own, self._session_file)

    def decide_at_router(self, request: OperationRequest) -> Verdict:
        """Return the decision on a message of a session that ignores its own access control."""
        if self.refusal:
            return Verdict(allowed=False, reason=self.refusal, where=Origin(self._session_file))
        return _verdict(request, self.at_router(request), self._router_file)


def _verdict(request: OperationRequest, decision: Verdict, file: str) -> Verdict:
    return Verdict(decision.allowed, f"{request}: {decision.reason}", decision.where or Origin(file))


class InstalledModels:
    """The models of enclaves.

    Args:
        enclaves: the enclaves.
        environment: the clock, and what was read before in this run.

    Attributes:
        enclaves: the enclaves by subject.
    """

    def __init__(self, enclaves: Iterable[InstalledEnclave], environment: Environment) -> None:
        self.enclaves = EnclavesBySubject((enclave.subject, enclave) for enclave in enclaves)
        self._environment = environment
        self._routers: dict[Path, InstalledConfiguration] = {}
        self._models: dict[str, ZenohEnclaveModel] = {}

    def of(self, subject: str) -> ZenohEnclaveModel:
        """Return the model of a subject.

        Raises:
            KeymintError: the subject has no enclave, or a file of it cannot be read.
        """
        if subject not in self._models:
            enclave = self.enclaves[subject]
            self._models[subject] = ZenohEnclaveModel(enclave, self.router(enclave.install), self._environment)
        return self._models[subject]

    def router(self, install: Path) -> InstalledConfiguration:
        """Return the configuration of the router of an install space.

        Raises:
            KeymintError: it cannot be read.
        """
        if install not in self._routers:
            self._routers[install] = configuration(install / ROUTER, install, self._environment)
        return self._routers[install]


def _refusal(session: InstalledConfiguration, router: InstalledConfiguration, environment: Environment) -> str:
    """Return why a session and a router have no link, or an empty text."""
    own, other = session.configuration, router.configuration
    listened = {loopback.port(endpoint) for endpoint in other.listen}
    endpoints = [endpoint for endpoint in own.connect if loopback.port(endpoint) in listened]
    if not endpoints:
        return "the session does not connect to a port of the router"
    certificate = session.content(own.connect_certificate)
    reason = decision.refusal(certificate, router.content(other.root_ca), environment.now, server=False)
    if reason:
        return f"the router refuses the certificate of the session: {reason}"
    certificate = router.content(other.listen_certificate)
    reason = decision.refusal(certificate, session.content(own.root_ca), environment.now, server=True)
    if not reason and own.verify_name:
        leaf = certificates.load_bundle(certificate)[0]
        if not any(decision.names_host(leaf, loopback.host(endpoint)) for endpoint in endpoints):
            reason = "no subjectAltName of it is the host that the session connects to"
    return f"the session refuses the certificate of the router: {reason}" if reason else ""


def edge_verdict(
    operations: Sequence[Operation],
    decide: Callable[[OperationRequest], Verdict],
    at_router: Callable[[OperationRequest], Verdict],
) -> Verdict:
    """Return the decision on an edge.

    It is allowed if all messages of all operations are. It is allowed in part if not, but the router permits the
    messages of one of the ways to do an operation: a session need not keep to the conventions of ROS, nor to its own
    access control.

    Args:
        operations: the operations of the edge; none if no key can have its name.
        decide: decides on a message at the router and at the session's own access control.
        at_router: decides on a message at the router alone.
    """
    first: Verdict | None = None
    denied: dict[Operation, tuple[OperationRequest, Verdict]] = {}
    for operation in operations:
        for request in operation.requests:
            verdict = decide(request)
            first = first or verdict
            if not verdict.allowed:
                denied[operation] = request, verdict
                break
    if not denied:
        return first or NAMELESS
    missing, denial = next(iter(denied.values()))
    for operation in denied:  # one that is whole may be permitted for its own sake: the edge is composite
        for way in operation.ways:
            permitted = [at_router(request) for request in way]
            if all(verdict.allowed for verdict in permitted):
                reason = f"in part: {permitted[0].reason}; but {denial.reason}"
                # If the router permits all, the session's own file is the one to look at.
                where = denial.where if at_router(missing).allowed else permitted[0].where
                return Verdict(allowed=False, reason=reason, where=where, partial=True)
    return denial


class SimulatedZenoh(Transport):
    """A transport with the model of Zenoh 1.6 and later."""

    def __init__(self, environment: Environment) -> None:
        self.environment = environment

    def usable(self) -> Availability:
        """Return that it is usable."""
        return Availability(usable=True, version="1", tiers=(Tier.DECISION,))

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        del tier
        models = InstalledModels(enclaves, self.environment)
        for edge in edges:
            model = models.of(edge.subject)
            yield edge, edge_verdict(operations(edge), model.decide, model.decide_at_router)
