# SPDX-License-Identifier: Apache-2.0
"""Secure participants of a real vendor on loopback, each in a process of its own.

A participant is a probe (:mod:`~keymint_ros2_dds.vendors.probe_builds`) that reads one command per line. The words of a
line are separated by tabs, and each line is answered by one line:

=================================================  ==================================================
``OPEN domain enclave crl …``                      ``OPENED``, or ``REFUSED reason``
``EDGE name publish|subscribe topic partition…``   ``ALLOWED``, or ``DENIED reason``; the edge stays
``TRY publish|subscribe topic partition…``         the same, and the edge is deleted at once
``AWAIT name milliseconds``                        ``MATCHED count``, ``REJECTED reason`` or ``TIMEOUT``
``WRITE name text``                                ``WRITTEN``
``READ name milliseconds``                         ``SAMPLE text`` or ``TIMEOUT``
``CLOSE``                                          ``CLOSED``, and the process ends
=================================================  ==================================================

``crl`` is the name of a revocation list in the folder of the enclave, or empty. The properties are those that
``rmw_cyclonedds`` and ``rmw_fastrtps`` set if the enclave has a ``crl.pem``.
"""

from __future__ import annotations

import random
import socket
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

from keymint.host.vendor_process import CommandProcess, ProcessFailedError
from keymint_ros2_dds.enclave_layout import CRL
from keymint_ros2_dds.vendors import cyclone_access_control, probe_builds
from keymint_ros2_dds.vendors.probe_builds import Probe, Unpacked

PORTS = 40
"""Ports of a system: the first ten are not for participants, each of which then has two (RTPS 2.2, 9.6.1.1)."""
FIRST_PARTICIPANT = 10
_GUARD = 5
_RANGE = range(20_000, 32_000, PORTS)
"""First ports of the blocks, below the kernel's ephemeral range."""
_AT_ONCE = 32
"""Commands that are sent before their answers are read; they fit into a pipe."""


class RefusedError(Exception):
    """The vendor refuses to create the participant."""


class DeniedError(Exception):
    """The vendor denies the writer or reader."""


@dataclass(frozen=True, slots=True)
class Vendor(ABC):
    """How participants of a vendor are started.

    Attributes:
        program: the vendor's built probe program.
        environment: environment variables of every process.
        nonconforming: the built library that makes a participant ignore its own permissions, if any.
        version: the version in the cache that the programs are built from, if it is not the machine's.
        PROBE: how to build the program.
        NONCONFORMING: how to build the library.
    """

    PROBE: ClassVar[Probe]
    NONCONFORMING: ClassVar[Probe]
    program: Path
    environment: Mapping[str, str] = field(default_factory=dict, repr=False)
    nonconforming: Path | None = None
    version: Unpacked | None = None

    @property
    def command(self) -> tuple[str, ...]:
        """The words that start the program; with a version it runs with the libraries of that and no others."""
        if self.version is None:
            return (str(self.program),)
        return str(self.version.loader), "--library-path", str(self.version.libraries), str(self.program)

    @abstractmethod
    def start(self, first_port: int, index: int, *, conforming: bool) -> tuple[Mapping[str, str], tuple[str, ...]]:
        """Return the environment variables of the process, and the vendor's further words of ``OPEN``.

        Args:
            first_port: first of the ports that belong to the system.
            index: the participant's number in the system, from 0.
            conforming: the participant enforces its own permissions; otherwise only its peers do.
        """


def cyclonedds_on_loopback(index: str, most: int, more: str = "") -> str:
    """Return a configuration of Cyclone DDS, for ``CYCLONEDDS_URI``: unicast on loopback, and nothing else.

    Args:
        index: number of the participant, or ``auto``.
        most: the greatest number that a participant may have.
        more: more settings of the discovery.
    """
    return (
        "<CycloneDDS><Domain Id='any'><General><Interfaces>"
        "<NetworkInterface address='127.0.0.1' multicast='false'/></Interfaces>"
        "<AllowMulticast>false</AllowMulticast></General><Discovery><Peers><Peer Address='127.0.0.1'/></Peers>"
        f"<ParticipantIndex>{index}</ParticipantIndex><MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex>"
        f"{more}</Discovery></Domain></CycloneDDS>"
    )


class CycloneDDS(Vendor):
    """Participants of Cyclone DDS; the transport is configured as for any application, by ``CYCLONEDDS_URI``."""

    PROBE = probe_builds.CYCLONEDDS
    NONCONFORMING = probe_builds.CYCLONEDDS_NONCONFORMING

    def start(self, first_port: int, index: int, *, conforming: bool) -> tuple[Mapping[str, str], tuple[str, ...]]:
        """Return the configuration (unicast, loopback and ports of this system only) and the plugins' folder."""
        ports = f"<Ports><Base>{first_port}</Base><DomainGain>0</DomainGain></Ports>"
        plugins = self.version.plugins if self.version else cyclone_access_control.library().folder
        environment = {**self.environment, "CYCLONEDDS_URI": cyclonedds_on_loopback(str(index), 9, ports)}
        if conforming:
            return environment, (str(plugins),)
        environment["KEYMINT_VENDOR_PLUGIN"] = str(plugins / "libdds_security_ac.so")
        return environment, (str(plugins), str(self.nonconforming))


class FastDDS(Vendor):
    """Participants of Fast DDS; the transport is configured by the probe.

    The process's time zone is UTC, because Fast DDS reads the dates of permissions as local time.
    """

    PROBE = probe_builds.FASTDDS
    NONCONFORMING = probe_builds.FASTDDS_NONCONFORMING

    def start(self, first_port: int, index: int, *, conforming: bool) -> tuple[Mapping[str, str], tuple[str, ...]]:
        """Return the time zone, and the first port of participants followed by the participant's number."""
        environment = {**self.environment, "TZ": "UTC"}
        if not conforming:
            environment["LD_PRELOAD"] = str(self.nonconforming)
        return environment, (str(first_port + FIRST_PARTICIPANT), str(index))


class FastDDS3(FastDDS):
    """Participants of Fast DDS 3."""

    PROBE = probe_builds.FASTDDS_3


class System(ExitStack):
    """Participants that discover each other and no others; their processes end with the context."""

    def __init__(self, vendor: Vendor) -> None:
        super().__init__()
        self.vendor = vendor
        self._opened = 0
        self.first_port = 0

    def __enter__(self) -> Self:
        self.first_port = self.enter_context(free_ports())
        return self

    def open(
        self, enclave: Path, domain: int = 0, *, conforming: bool = True, revocations: bool = True
    ) -> ProbeParticipant:
        """Start a process with a participant that uses the files of an enclave.

        Args:
            enclave: the folder.
            domain: DDS domain id.
            conforming: the participant enforces its own permissions; otherwise only its peers do.
            revocations: the participant reads the revocation list of the enclave, if there is one, as ROS 2 from
                Humble on does.

        Raises:
            RefusedError: the vendor refuses; the process has ended.
        """
        index, self._opened = self._opened, self._opened + 1
        environment, words = self.vendor.start(self.first_port, index, conforming=conforming)
        process = ProbeProcess(self.vendor.command, environment, "the probe")
        self.callback(process.reap)
        crl = CRL if revocations and (enclave / CRL).exists() else ""
        answer, reason = process.ask("OPEN", str(domain), str(enclave.resolve()), crl, *words)
        if answer != "OPENED":
            process.reap()
            raise RefusedError(reason)
        return ProbeParticipant(process)


class ProbeParticipant:
    """A participant in a process of its own."""

    def __init__(self, process: ProbeProcess) -> None:
        self._process = process
        self._edges = 0

    def edge(self, direction: str, topic: str, partitions: Iterable[str] = ()) -> ProbeEndpoint:
        """Create a writer or a reader.

        Raises:
            DeniedError: the vendor denies it.
        """
        name, self._edges = f"edge{self._edges}", self._edges + 1
        answer, reason = self._process.ask("EDGE", name, direction, topic, *partitions)
        if answer != "ALLOWED":
            raise DeniedError(reason)
        return ProbeEndpoint(self._process, name)

    def allows(self, direction: str, topic: str, partitions: Iterable[str] = ()) -> bool:
        """Tell whether the vendor allows a writer or reader; it is deleted at once."""
        return self.ask(direction, topic, partitions)[0]

    def ask(self, direction: str, topic: str, partitions: Iterable[str] = ()) -> tuple[bool, str]:
        """Tell the same, with the vendor's message if it denies."""
        answer, reason = self._process.ask("TRY", direction, topic, *partitions)
        return answer == "ALLOWED", reason.strip()

    def allow(self, endpoints: Iterable[tuple[str, str, Iterable[str]]]) -> list[bool]:
        """Tell which endpoints the vendor allows: direction, topic and partitions of each; all are deleted at once."""
        commands = [("TRY", direction, topic, *partitions) for direction, topic, partitions in endpoints]
        return [answer == "ALLOWED" for answer, _ in self._process.ask_all(commands)]


class ProbeEndpoint:
    """A writer or reader of a participant."""

    def __init__(self, process: ProbeProcess, name: str) -> None:
        self._process = process
        self._name = name

    def write(self, text: str) -> None:
        """Publish a sample."""
        self._process.ask("WRITE", self._name, text)

    def read(self, seconds: float = 20.0) -> str | None:
        """Return the next sample, or None when none comes in time."""
        answer, text = self._process.ask("READ", self._name, str(round(seconds * 1000)), seconds=seconds)
        return text if answer == "SAMPLE" else None

    def receives(self, text: str, seconds: float) -> bool:
        """Wait until a sample arrives; skip samples of other writers on the topic."""
        while (sample := self.read(seconds)) is not None:
            if sample == text:
                return True
        return False


class ProbeProcess(CommandProcess):
    """A probe's process."""

    def ask(self, *words: str, seconds: float = 0.0) -> tuple[str, str]:
        """Send a command; return the first word of its answer, and the rest."""
        (answer,) = self.ask_all([words], seconds)
        return answer

    def ask_all(self, commands: Sequence[Sequence[str]], seconds: float = 0.0) -> Iterator[tuple[str, str]]:
        """Send commands, several at a time; yield the first word of each answer, and the rest."""
        for begin in range(0, len(commands), _AT_ONCE):
            lines = list(map(_line_of, commands[begin : begin + _AT_ONCE]))
            self._send(lines[0], "".join(f"{line}\n" for line in lines).encode())
            for line in lines:
                yield self.answer(line, seconds)

    def answer(self, command: str, seconds: float = 0.0) -> tuple[str, str]:
        """Return the first word of the answer to a command that was sent, and the rest."""
        answer, _, rest = self._line(command, seconds).decode(errors="replace").partition(" ")
        if answer == "ERROR":
            raise ProcessFailedError(f"{command!r} was answered with {rest!r}")
        return answer, rest


def _line_of(words: Sequence[str]) -> str:
    line = "\t".join(words)
    if "\n" in line or line.count("\t") != len(words) - 1:
        raise ProcessFailedError(f"words with a tab or a newline cannot be sent: {words}")
    return line


@contextmanager
def free_ports() -> Iterator[int]:
    """Yield the first of a block of UDP ports on loopback that no other system uses, in this process or another.

    One port that no participant uses stays bound as long as the context; whoever binds it owns the block.

    Raises:
        OSError: no block is free.
    """
    for first in random.sample(_RANGE, len(_RANGE)):
        guard = _bound(first + _GUARD)
        if guard is None:
            continue
        with guard:
            others = [_bound(first + offset) for offset in range(PORTS) if offset != _GUARD]
            for other in filter(None, others):
                other.close()
            if None not in others:
                yield first
                return
    raise OSError("no free block of UDP ports on loopback")


def _bound(port: int) -> socket.socket | None:
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.bind(("127.0.0.1", port))
    except OSError:
        bound.close()
        return None
    return bound
