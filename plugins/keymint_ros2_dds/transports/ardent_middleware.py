# SPDX-License-Identifier: Apache-2.0
"""The middleware of ROS 2 Ardent, on any transport: the partitions in which it creates the endpoints of services.

It created the endpoints of a service in the empty partition first, and moved them to the service's partition later
(White et al. 2018, "Procedurally Provisioned Access Control for Robotic Systems", section on results). Access control
checks an endpoint when it is created, so it sees the empty partition only: the permissions of a service deny its own
endpoints, and permissions that also allow the empty partition admit those of every service of that base name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, tee

from comarmor.values import replace
from keymint.api import Availability, InstalledEnclave, Tier, Transport, Verdict
from keymint.api.graph import Edge
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.lowering.name_mapping import ARDENT

_OF_SERVICES = ("rq", "rr")
DEVIATION = "ardent-services: ROS 2 Ardent creates the endpoints of services in the empty partition first"
"""How this differs from the name mapping; see :attr:`keymint.api.Verdict.deviation`."""


def created_endpoints(distro: str, edge: Edge) -> tuple[Edge, ...]:
    """Return the endpoints of an edge at their creation by the middleware.

    Args:
        distro: ROS 2 distribution; all but Ardent create endpoints in their partition.
        edge: an edge of any kind.

    Raises:
        KeymintError: the distribution or the permission is unknown.
    """
    needed = endpoints(distro, edge)
    if distro != ARDENT or edge.object.kind == "topic":
        return needed
    return tuple(
        replace(endpoint, object=replace(endpoint.object, partitions=()))
        if any(partition.split("/")[0] in _OF_SERVICES for partition in endpoint.object.partitions)
        else endpoint
        for endpoint in needed
    )


class ArdentMiddleware(Transport):
    """Asks a transport about the endpoints that the middleware creates."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport

    def usable(self) -> Availability:
        """Return whether the transport is usable; not for exchange of data, because partitions change before it."""
        availability = self.transport.usable()
        tiers = tuple(tier for tier in availability.tiers if tier is not Tier.EXCHANGE)
        return replace(availability, tiers=tiers, by_default=False)

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        distros = {enclave.subject: enclave.distro for enclave in enclaves}
        asked, waiting = tee((edge, created_endpoints(distros[edge.subject], edge)) for edge in edges)
        answers = self.transport.label(enclaves, (endpoint for _, needed in asked for endpoint in needed), tier)
        for edge, needed in waiting:
            yield edge, _together(edge, list(islice(answers, len(needed))))


def _together(edge: Edge, answers: Sequence[tuple[Edge, Verdict]]) -> Verdict:
    """Return the verdict on all endpoints of an edge: the first denial, else the last one."""
    endpoint, verdict = next((answer for answer in answers if not answer[1].allowed), answers[-1])
    if endpoint == edge:
        return verdict
    place = " ".join(endpoint.object.partitions) or "the empty partition"
    reason = f"{endpoint.permission} {endpoint.object.name} in {place}: {verdict.reason}"
    moved = verdict.deviation or ("" if endpoint.object.partitions else DEVIATION)
    return replace(verdict, reason=reason, deviation=moved)
