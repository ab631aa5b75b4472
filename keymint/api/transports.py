# SPDX-License-Identifier: Apache-2.0
"""Transports, simulated and real, their decisions on installed enclaves, and sources of graphs, which observe them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import NoReturn

from comarmor.values import Data, field
from keymint.api.graph import Column, Edge, Graph
from keymint.errors import Diagnostic, KeymintError, Origin


class Tier(StrEnum):
    """How a transport is tested.

    ``decision``: call its access-control code. ``admission``: connect as each enclave, and create its endpoints.
    ``exchange``: run two processes, and see whether data is delivered.
    """

    DECISION = "decision"
    ADMISSION = "admission"
    EXCHANGE = "exchange"


class Availability(Data):
    """Whether a transport can be used on this machine, and if not, how to install what is missing.

    Attributes:
        usable: it can be used.
        version: version of the software, or of the software that it models.
        reason: why it cannot be used, or only in part.
        help: how to install what is missing.
        tiers: the supported tiers.
        by_default: it is used if the user names no transport; False for one that is known not to follow the policy.
    """

    usable: bool
    version: str = ""
    reason: str = ""
    help: str = ""
    tiers: tuple[Tier, ...] = ()
    by_default: bool = True

    @property
    def names_rules(self) -> bool:
        """Whether a transport decides by the documents alone, so it can name the rule that decides."""
        return self.tiers == (Tier.DECISION,)

    def require(self, tier: Tier, name: str) -> None:
        """Check that a transport supports a tier.

        Args:
            tier: the tier.
            name: name of the transport.

        Raises:
            KeymintError: it does not.
        """
        if tier not in self.tiers:
            reason = self.reason or f"it has no tier {tier}"
            message = f"the transport {name!r} cannot be used at tier {tier}: {reason}"
            raise KeymintError(message, help=self.help, code="transport-unusable")


class InstalledEnclave(Data):
    """An installed enclave.

    Attributes:
        subject: its subject.
        folder: absolute path of its folder.
        distro: ROS 2 distribution whose name mapping applies.
        install: absolute path of the install space, with the files that enclaves share and the enclaves of the
            infrastructure. ``verify`` gives transports a copy.
    """

    subject: str
    folder: Path
    distro: str
    install: Path


class Endpoint(Data, order=True):
    """An action of a subject on a name of its transport.

    Attributes:
        subject: the subject.
        action: the action, in the words of the transport.
        name: the name on the transport; empty if the action is on no name.
        partitions: the partitions of the name, if the transport has them. Empty is the default partition.
        domain: the domain id.
    """

    subject: str
    action: str
    name: str
    partitions: tuple[str, ...] = ()
    domain: int = 0


class Verdict(Data):
    """A transport's decision on an edge.

    Attributes:
        allowed: the decision.
        reason: one line, without the place: the rule of the document, or the transport's message.
        where: the rule that decided, with the path of its file; without a line if no rule of the file did. None if no
            file decided.
        deviation: the row in the table of vendor deviations that explains a difference from the standard, or empty.
        partial: the subject can use the edge in some way, but not everything that the edge needs is permitted. That is
            a mismatch whatever the policy says; ``allowed`` is False.
    """

    allowed: bool
    reason: str = ""
    where: Origin | None = None
    deviation: str = ""
    partial: bool = False


class Environment(Data):
    """The environment of a transport; plugins do not read it themselves.

    Attributes:
        now: the clock, UTC, for simulated transports; real ones use the clock of the machine.
        cache: folder of this user in which real transports cache the programs that they build; created on demand.
        variables: environment variables for the processes that real transports start.
        opened: documents that transports of this run have verified and read, by the digest of their files.
    """

    now: datetime
    cache: Path
    variables: Mapping[str, str] = field(default_factory=dict, repr=False)
    opened: dict[bytes, object] = field(default_factory=dict, repr=False, compare=False)


class Transport(ABC):
    """Decides edges between installed enclaves, as a simulated or a real transport does."""

    ADMITS: bool = False
    """It decides about many endpoints at once by :meth:`admitted`, since its build type maps names.

    It allows an edge if it admits all endpoints of the edge, and gives the reasons by :meth:`label`.
    """
    SELECTIVE: bool = False
    """It cannot be asked about every edge: see :meth:`asked`.

    ``verify`` then asks all transports of the run what these can be asked, and does not ask for single endpoints.
    """

    @abstractmethod
    def usable(self) -> Availability:
        """Return whether it can be used on this machine; never raises."""

    @abstractmethod
    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """Yield the decision on each edge, in the order of the edges.

        Args:
            enclaves: the enclaves of all subjects of the edges.
            edges: edges to decide, grouped by subject; consumed lazily to save memory.
            tier: one of those that :meth:`usable` returns.

        Raises:
            KeymintError: an enclave is refused completely (code ``enclave-refused``), or the transport fails.
        """

    def admitted(self, enclave: InstalledEnclave, endpoints: Column, tier: Tier) -> bytes:
        """Return which endpoints it admits, one byte each: 1 admitted, 0 refused.

        Args:
            enclave: the enclave of the subject.
            endpoints: requests of kind ``topic``.
            tier: one of those that :meth:`usable` returns, except *exchange*, which needs peers.

        Raises:
            KeymintError: as of :meth:`label`.
        """
        raise NotImplementedError

    def asked(self, enclave: InstalledEnclave, edge: Edge) -> Sequence[Edge]:
        """Return the edges that it can be asked about in place of an edge; none if there is none like it."""
        del enclave
        return (edge,)


class TransportType:
    """The registered entry point of a transport: opens it, without side effects.

    Args:
        version: the version of the plugin interface that the transport is written for.
        build_type: name of the build type whose files the transport reads.
        make: returns the transport in an environment, and never raises; it tells itself whether it is usable.
    """

    def __init__(self, version: str, build_type: str, make: Callable[[Environment], Transport]) -> None:
        self.API = version
        self.BUILD_TYPE = build_type
        self.open = make


class DiscoveredGraph(Data):
    """An observed graph, and findings on it (e.g. how its subjects were named)."""

    graph: Graph
    diagnostics: tuple[Diagnostic, ...] = ()


class GraphSource(ABC):
    """Discovers access graphs in a running system or in a capture file.

    Attributes:
        API: version of the plugin interface.
        CAPTURES: what :meth:`read` reads, for messages, e.g. ``XML of an administration console``.
    """

    API: str
    CAPTURES: str

    @abstractmethod
    def usable(self) -> Availability:
        """Return whether a running system can be observed on this machine; never raises."""

    @abstractmethod
    def observe(self, domain: int, go_on: Callable[[], bool], names: Mapping[str, str]) -> DiscoveredGraph:
        """Observe a domain, and return its graph in the transport's terms (objects of kind ``topic``).

        An empty graph comes with a diagnostic that says where to look.

        Args:
            domain: domain id.
            go_on: polled; the observation ends when it returns False.
            names: subjects by an identifier in the running system, or the beginning of one, which override discovered
                names.

        Raises:
            KeymintError: software that the observation needs is missing or fails.
        """

    @abstractmethod
    def recognises(self, content: bytes) -> bool:
        """Whether a file is a capture that :meth:`read` can read."""

    @abstractmethod
    def read(self, content: bytes, name: str, names: Mapping[str, str]) -> DiscoveredGraph:
        """Return the graph in a capture, in the transport's terms.

        Args:
            content: the file.
            name: its path as the user would type it, for messages.
            names: as for :meth:`observe`.

        Raises:
            KeymintError: with ``file:line`` of the defect.
        """

    @abstractmethod
    def interpret(self, graph: Graph, *, fold: bool) -> Graph:
        """Translate a graph into application names; edges that have none, or are translated already, stay unchanged.

        Args:
            graph: objects of any kind.
            fold: True to merge complete sets of parts into composite permissions, False to split these into parts.
        """


# -- installed enclaves and their files, as transports look for them --------------------------------------------------


class EnclavesBySubject(dict[str, InstalledEnclave]):
    """The enclaves that a transport decides about; to ask for another one is a :class:`KeymintError`."""

    def __missing__(self, subject: str) -> NoReturn:
        raise KeymintError(f"{subject} has no installed enclave", help="run 'keymint install'", code="enclave-missing")


def installed_file(file: Path) -> bytes:
    """Return an installed file.

    Raises:
        KeymintError: it cannot be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise KeymintError(
            f"{file.name} cannot be read: {error.strerror}",
            where=Origin(str(file)),
            help="run 'keymint install'",
            code="enclave-file",
        ) from None
