# SPDX-License-Identifier: Apache-2.0
"""Simulated transports: the decision point on the signed documents of installed enclaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from comarmor.values import dataclass
from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.api.graph import Column, Edge
from keymint_ros2_dds.decision import OMG, VARIATIONS, Variation
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports.enclave_model import EnclaveModels


@dataclass(frozen=True, slots=True)
class Simulated:
    """A transport that decides as the standard, or as the model of a vendor."""

    variation: Variation
    environment: Environment

    def usable(self) -> Availability:
        """Return that it is usable."""
        version = "1.1" if self.variation is OMG else self.variation.name.rpartition("-")[2]
        return Availability(usable=True, version=version, tiers=(Tier.DECISION,))

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        del tier
        models = EnclaveModels(enclaves, self.environment)
        for edge in edges:
            needed = endpoints(models.enclaves[edge.subject].distro, edge)
            yield edge, models.of(edge.subject, edge.domain).verdict(self.variation, needed)

    def admitted(self, enclave: Enclave, endpoints: Column, tier: Tier) -> bytes:
        """See :meth:`keymint.api.EndpointTransport.admitted`."""
        del tier
        return EnclaveModels([enclave], self.environment).admitted(enclave.subject, self.variation, endpoints)


def simulated(name: str, environment: Environment) -> Simulated:
    """Return the simulated transport of this name."""
    return Simulated(VARIATIONS[name], environment)
