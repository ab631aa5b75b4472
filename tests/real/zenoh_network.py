# SPDX-License-Identifier: Apache-2.0
"""Real routers and sessions on the files of an install space, for tests that attack them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any

from keymint_ros2_zenoh.vendors.loopback import free_port
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohProcess, ZenohSystem

from tests.plugins.keymint_ros2_zenoh.install_spaces import InstallSpace, merged

from .zenoh_system import ZenohTestSystem

FENCE = "0/fence/type/hash"
"""A topic on which the sender of a test may always send, to know that what came before it did not get through."""
_SECONDS = 10.0
_ROUNDS = 3
"""How often an attack is repeated: a message that closely follows declarations may get lost by chance."""


@dataclass
class RealNetwork:
    """Routers in a process, and sessions in another.

    Attributes:
        space: the install space that files come from.
        system: processes and files.
        routers: the process of routers.
        sessions: the process of sessions.
        port: the port of the last router.
    """

    space: InstallSpace
    system: ZenohSystem
    routers: ZenohProcess
    sessions: ZenohProcess
    port: int = 0

    def __post_init__(self) -> None:
        self._numbers = count()

    def router(self, changes: Mapping[str, Any] | None = None, enclave: str = "zenoh_router") -> str:
        """Start the installed router, or one with changes and the certificate of another enclave."""
        self.port = free_port()
        document = merged(self.space.router(), {"listen": {"endpoints": [f"tls/127.0.0.1:{self.port}"]}})
        return self._open(self.routers, merged(document, changes or {}), enclave)

    def session(self, path: str, changes: Mapping[str, Any] | None = None, enclave: str | None = None) -> str:
        """Open the installed session of an enclave, or one with changes and the certificate of another enclave."""
        folder = self.space.folder / "enclaves" / path
        document = merged(self.space.installed_session(folder), _to(self.port))
        return self._open(self.sessions, merged(document, changes or {}), enclave or path)

    def arrives(self, sender: str, key: str, receiver: str, subscription: str, fence: str = FENCE) -> bool:
        """Tell whether a sample arrives; a sample on the fence, which must arrive, follows each one.

        Args:
            sender: session that sends.
            key: key expression of the sample.
            receiver: session that receives.
            subscription: its key expression.
            fence: key that the sender may send on and the receiver may receive from.
        """
        box, end = f"box{next(self._numbers)}", f"box{next(self._numbers)}"
        self.sessions.ask("subscribe", session=receiver, keys={box: subscription, end: fence})
        arrived = False
        for number in range(_ROUNDS):
            last = f"{box} {number}"
            self._await(sender, fence, end, last, [(key, "attack")])
            boxes = self.sessions.ask("received", names=[end, box], last=last, wait=0.1)
            arrived |= any(text == "attack" for _, text in boxes[box])
        return arrived

    def reaches(self, sender: str, receiver: str, key: str) -> bool:
        """Tell whether samples arrive within some seconds, where there is no other way to know that they will not."""
        box = f"box{next(self._numbers)}"
        self.sessions.ask("subscribe", session=receiver, keys={box: key})
        for _ in range(20):
            self.sessions.ask("put", session=sender, samples=[(key, box)])
            if self.sessions.ask("received", names=[box], last=box, wait=0.15)[box]:
                return True
        return False

    def _await(self, sender: str, fence: str, box: str, last: str, before: Sequence[tuple[str, str]]) -> None:
        """Send samples and then one on the fence, until that arrives."""
        for _ in range(20):
            self.sessions.ask("put", session=sender, samples=[*before, (fence, last)])
            found = self.sessions.ask("received", names=[box], last=last, wait=_SECONDS / 20)
            if any(text == last for _, text in found[box]):
                return
        raise AssertionError("no sample on the fence arrived, so nothing is known about the others")

    def _open(self, process: ZenohProcess, document: Mapping[str, Any], enclave: str) -> str:
        number = next(self._numbers)
        folder = self.space.folder / "enclaves" / enclave
        role = "listen" if document["mode"] == "router" else "connect"
        tls = {
            "root_ca_certificate": str(folder / "identity_ca.cert.pem"),
            f"{role}_certificate": str(folder / "cert.pem"),
            f"{role}_private_key": str(folder / "key.pem"),
        }
        if document["mode"] == "peer":  # it listens and connects
            tls |= {"listen_certificate": tls["connect_certificate"], "listen_private_key": tls["connect_private_key"]}
        document = merged(document, {"transport": {"link": {"tls": tls}}})
        file = self.system.file(f"configuration{number}.json5", json.dumps(document).encode())
        process.open(f"session{number}", file, {})
        return f"session{number}"


@contextmanager
def real_network(space: InstallSpace) -> Iterator[RealNetwork]:
    """Write an install space and yield a network without routers; its processes end with the context."""
    space.write()
    with ZenohTestSystem(os.environ) as system:
        yield RealNetwork(space, system, system.start(), system.start())


def _to(port: int) -> dict[str, Any]:
    return {"connect": {"endpoints": [f"tls/localhost:{port}"]}}
