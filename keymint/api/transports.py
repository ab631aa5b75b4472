"""Transports, simulated and real, and what they decide."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from comarmor.errors import Origin
from keymint.graph import Edge


class Tier(StrEnum):
    """How deep a transport is asked.

    ``decision``: its access-control code decides. ``admission``: a participant per enclave, endpoints are created.
    ``exchange``: two processes, data is delivered or not.
    """

    DECISION = "decision"
    ADMISSION = "admission"
    EXCHANGE = "exchange"


@dataclass(frozen=True, slots=True)
class Availability:
    """Whether a transport can be used here: what it is, and how to install what it lacks.

    Attributes:
        usable: it can.
        version: of what it is, or is a model of.
        reason: why it cannot be used, or not wholly.
        help: how to install what is missing.
        tiers: how deep it can be asked.
        by_default: it is asked where none is named; False for one that is known not to follow the policy.
    """

    usable: bool
    version: str = ""
    reason: str = ""
    help: str = ""
    tiers: tuple[Tier, ...] = ()
    by_default: bool = True


@dataclass(frozen=True, slots=True)
class Enclave:
    """An installed enclave.

    Attributes:
        subject: its subject.
        folder: absolute path of its folder.
        distro: ROS 2 distribution whose name mapping applies.
    """

    subject: str
    folder: Path
    distro: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a transport decides about an edge.

    Attributes:
        allowed: the decision.
        reason: one line, without the place: the rule of the document, or the transport's own words.
        line: line of the rule in the signed document that decided, or 0.
        deviation: the row of the table of vendors' deviations that explains a difference from the standard, or empty.
        where: the place in a signed document that decided, or None.
    """

    allowed: bool
    reason: str = ""
    line: int = 0
    deviation: str = ""
    where: Origin | None = None


@dataclass(frozen=True, slots=True)
class Environment:
    """What a transport needs to know of where it runs, since plugins do not look for themselves.

    Attributes:
        now: the clock, UTC: simulated transports go by it, real ones by the clock of the machine.
        cache: a folder of this user in which real transports keep programs that they built; made when needed.
        variables: environment variables for the processes that real transports start.
        opened: documents that transports of this run have verified and read, by the digest of their files.
    """

    now: datetime
    cache: Path
    variables: Mapping[str, str] = field(default_factory=dict, repr=False)
    opened: dict[bytes, object] = field(default_factory=dict, repr=False, compare=False)


class Transport(Protocol):
    """Tells what a transport, simulated or real, decides when it is given installed enclaves."""

    def usable(self) -> Availability:
        """Tell whether it can be used on this machine; never raises."""

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """Yield what is decided about each edge, in the order of the edges.

        Args:
            enclaves: the enclaves of all subjects of the edges.
            edges: edges to decide, grouped by subject; consumed as they come, so that memory stays flat.
            tier: one of those that :meth:`usable` names.

        Raises:
            KeymintError: an enclave is refused as a whole (code ``enclave-refused``), or the transport does not work.
        """


class TransportType(Protocol):
    """What is registered as a transport: opens it, without side effect."""

    API: str

    def open(self, environment: Environment) -> Transport:
        """Return the transport, which is then asked whether it is usable; never raises."""
