# SPDX-License-Identifier: Apache-2.0
"""Stand-in nodes of the sourced ROS 2, in a network of their own that has nothing but loopback.

The nodes hold the keys of real enclaves and try to do what these may do. So they are started in namespaces of this user
(``unshare``, util-linux) only, which reach no other network and no memory that other processes share; a node that finds
itself elsewhere refuses to start (:mod:`ros_node`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from keymint.host.vendor_process import MissingVendorError, ProcessFailedError
from keymint_ros2_dds.vendors.participants import ProbeProcess, RefusedError, cyclonedds_on_loopback

_PROGRAM = str(Path(__file__).with_name("ros_node.py"))
UNSHARE = ("unshare", "--map-root-user", "--net", "--mount")
_ENTER = ("nsenter", "--user", "--preserve-credentials", "--net", "--mount", "--target")
_CONFIGURES = (
    "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS",
    "ROS_SECURITY_ENCLAVE_OVERRIDE",
)  # fmt: skip
"""Variables of the user's robot that would lead elsewhere."""
PRIVATE = Path("/dev/shm")  # noqa: S108
"""The network has another one."""
MISSING = "source a ROS 2 whose rmw implementation is one of DDS; docs/verification.md, 'On your robot's ROS'"


class RosNetwork(ExitStack):
    """A network in which nodes discover each other and no others; everything in it ends with the context.

    Args:
        variables: the environment of a shell that has sourced ROS 2.

    Attributes:
        inside: the words that run a program in the network.
        python: the Python of ROS.
        rmw: what the nodes use, e.g. ``rmw_cyclonedds_cpp``.
    """

    def __init__(self, variables: Mapping[str, str]) -> None:
        super().__init__()
        self._variables = {name: value for name, value in variables.items() if name not in _CONFIGURES}
        self._variables |= {
            "CYCLONEDDS_URI": cyclonedds_on_loopback("auto", 30),
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(PRIVATE),
            "TZ": "UTC",
        }
        self.python = ""
        self.inside: tuple[str, ...] = ()
        self.rmw = ""

    def __enter__(self) -> Self:
        """Make the network.

        Raises:
            MissingVendorError: no ROS 2 is sourced, or no namespace can be made here.
        """
        distro = self._variables.get("ROS_DISTRO")
        if not distro:
            raise MissingVendorError("ROS 2", "no ROS 2 is sourced (ROS_DISTRO is not set)", MISSING)
        reason = "there is no python3"
        # Keymint's own Python may come first on the path, in its environment.
        path = self._variables.get("PATH", os.defpath)
        pythons = (shutil.which("python3", path=folder) for folder in (path, "/usr/bin"))
        for python in dict.fromkeys(filter(None, pythons)):
            try:
                process = self._start((*UNSHARE, python, _PROGRAM, "network"), self._variables)
                _, answer = process.answer("network")
            except (OSError, ProcessFailedError) as error:
                reason = str(error).splitlines()[-1]
                self.close()
                continue
            pid, self.rmw = answer.split()
            self.inside, self.python = (*_ENTER, pid), python
            return self
        raise MissingVendorError("ROS 2", f"no node of {distro} can run in a network of its own: {reason}", MISSING)

    def variables(self, install: Path | None, domain: int = 0) -> Mapping[str, str]:
        """Return the environment of a node.

        Args:
            install: the install space; None for a node without security.
            domain: the domain id.
        """
        security = {"ROS_SECURITY_ENABLE": "false" if install is None else "true", "ROS_SECURITY_STRATEGY": "Enforce"}
        keystore = {} if install is None else {"ROS_SECURITY_KEYSTORE": str(install)}
        return {**self._variables, **security, **keystore, "ROS_DOMAIN_ID": str(domain)}

    def node(self, install: Path | None, enclave: str, domain: int = 0) -> ProbeProcess:
        """Start a node; its commands are those of :mod:`ros_node`.

        Args:
            install: the install space; None to start it without security.
            enclave: the enclave's path.
            domain: the domain id.

        Raises:
            RefusedError: ROS does not create it.
            ProcessFailedError: its process fails.
        """
        process = self._start((*self.inside, self.python, _PROGRAM), self.variables(install, domain))
        answer, text = process.ask("OPEN", enclave)
        if answer != "OPENED":
            process.reap()
            raise RefusedError(text)
        return process

    def _start(self, words: Sequence[str], environment: Mapping[str, str]) -> ProbeProcess:
        process = ProbeProcess(words, environment, "the node")
        self.callback(process.reap)
        return process
