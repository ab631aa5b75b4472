# SPDX-License-Identifier: Apache-2.0
"""What of an installed configuration is changed to run it on the loopback of this machine, and nothing else.

- The port of each endpoint: installations that are tested at the same time must not meet.
- Its host: ``127.0.0.1`` where the router listens. Sessions connect to the host that they name if it is this machine's
  loopback. To any other host they connect as ``localhost`` without a check of the name, which the model does instead.
- The paths of certificates and keys: they are absolute paths on the robot.

Access control, modes, mutual TLS, scouting and all other settings are those of the files.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Mapping, Sequence

from keymint_ros2_zenoh.documents.configuration import TLS

LOOPBACK = ("localhost", "127.0.0.1")


def free_port() -> int:
    """Return a TCP port of 127.0.0.1 that nothing listens on now; another program may take it before it is used."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def router_changes(listen: Sequence[str], ports: Mapping[str, str]) -> dict[str, object]:
    """Return the changed endpoints of a router.

    Args:
        listen: endpoints of its configuration.
        ports: the new port by the port that the configuration names.
    """
    return {"listen/endpoints": [_changed(each, "127.0.0.1", ports[port(each)]) for each in listen]}


def session_changes(connect: Sequence[str], ports: Mapping[str, str]) -> dict[str, object]:
    """Return the changed endpoints of a session, and the check of the name if that changes.

    Args:
        connect: endpoints of its configuration.
        ports: the new port by the port of the router; other ports stay.
    """
    hosts = [host(each) for each in connect]
    endpoints = [
        _changed(each, name if name in LOOPBACK else "localhost", ports.get(port(each), port(each)))
        for each, name in zip(connect, hosts, strict=True)
    ]
    unnamed = {} if set(hosts) <= set(LOOPBACK) else {f"{TLS}/verify_name_on_connect": False}
    return {"connect/endpoints": endpoints, **unnamed}


def path_changes(settings: Mapping[str, object], local: Callable[[str], object]) -> dict[str, object]:
    """Return the changed paths of certificates and keys.

    Args:
        settings: settings of a configuration by their path; those of TLS that are texts are paths.
        local: returns where a file is on this machine, or None.
    """
    named = ((path, value) for path, value in settings.items() if path.startswith(TLS) and isinstance(value, str))
    return {path: str(file) for path, value in named if value and (file := local(value)) is not None}


def port(endpoint: str) -> str:
    """Return the port of an endpoint ``protocol/host:port``, which options may follow."""
    return _split(endpoint)[2]


def host(endpoint: str) -> str:
    """Return the host of an endpoint, without the brackets of an IPv6 address."""
    return _split(endpoint)[1].strip("[]")


def _changed(endpoint: str, new_host: str, new_port: str) -> str:
    protocol, _, _, options = _split(endpoint)
    return f"{protocol}/{new_host}:{new_port}{options}"


def _split(endpoint: str) -> tuple[str, str, str, str]:
    """Return protocol, host, port and options."""
    found = re.fullmatch(r"([^/]*)/(.*?)(?::(\d+))?([?#].*)?", endpoint, re.DOTALL)
    return ("", "", "", "") if found is None else (found[1], found[2], found[3] or "", found[4] or "")
