# SPDX-License-Identifier: Apache-2.0
"""A real router and real sessions that use installed files, changed for loopback as :mod:`loopback` says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count

from keymint.errors import KeymintError
from keymint.host.vendor_process import ProcessFailedError
from keymint_ros2_zenoh.transports.enclave_model import ZenohEnclaveModel
from keymint_ros2_zenoh.transports.installed_configurations import InstalledConfiguration
from keymint_ros2_zenoh.vendors import access_log, loopback
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError, ZenohSystem

ROUTER = "router"
_ATTEMPTS = 5
"""Another program may take a free port before the router does."""
_NO_ACCESS_CONTROL: Mapping[str, object] = {"access_control": {"enabled": False}}


@contextmanager
def running_network(router: InstalledConfiguration, variables: Mapping[str, str]) -> Iterator[Network]:
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

    def __init__(self, router: InstalledConfiguration, system: ZenohSystem) -> None:
        self.router = system.start(log=access_log.FILTER)
        self.sessions = system.start(log=access_log.FILTER)
        self._ports: Mapping[str, str] = {}
        self._numbers = count()
        self._open_router(router)

    def open(self, model: ZenohEnclaveModel, *, conforming: bool = True) -> str:
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

    def close(self, session: str) -> None:
        """Close a session."""
        self.sessions.ask("close", session=session)

    def _open_router(self, files: InstalledConfiguration) -> None:
        listen = files.configuration.listen
        for attempt in range(_ATTEMPTS):
            self._ports = {loopback.port(endpoint): str(loopback.free_port()) for endpoint in listen}
            try:
                self.router.open(ROUTER, files.file, loopback.router_changes(listen, self._ports) | _paths(files))
            except ZenohError as error:
                if attempt == _ATTEMPTS - 1 or "in use" not in str(error):
                    raise KeymintError(f"Zenoh does not start the router: {error}", code="enclave-refused") from None
            else:
                return


def _paths(files: InstalledConfiguration) -> dict[str, object]:
    return loopback.path_changes(files.configuration.settings(), files.local)
