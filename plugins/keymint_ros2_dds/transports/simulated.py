# SPDX-License-Identifier: Apache-2.0
"""Simulated transports: the decision point on the signed documents of installed enclaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from comarmor.values import dataclass
from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.graph import Column, Edge
from keymint_ros2_dds.decision import OMG, VARIATIONS, EndpointDecision, Variation
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports.enclave_model import EnclaveModel, EnclaveModels


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
            enclave_model = models.of(edge.subject, edge.domain)
            yield edge, self._verdict(enclave_model, endpoints(models.enclaves[edge.subject].distro, edge))

    def admitted(self, enclave: Enclave, endpoints: Column, tier: Tier) -> bytes:
        """See :meth:`keymint.api.EndpointTransport.admitted`."""
        del tier
        return EnclaveModels([enclave], self.environment).admitted(enclave.subject, self.variation, endpoints)

    def _verdict(self, enclave_model: EnclaveModel, needed: Sequence[Edge]) -> Verdict:
        deviation = ""
        verdict = Verdict(allowed=False, reason="this maps to no DDS endpoint", where=enclave_model.place())
        for endpoint in needed:
            modelled = enclave_model.decide(self.variation, endpoint)
            deviation = deviation or enclave_model.deviation(self.variation, endpoint, allowed=modelled.allowed)
            verdict = Verdict(modelled.allowed, _reason(modelled), enclave_model.place(modelled.line), deviation)
            if not modelled.allowed:
                break
        return verdict


def _reason(modelled: EndpointDecision) -> str:
    """Return the reason of a decision, with its place if that is not in the permissions."""
    return f"{modelled.where}: {modelled.reason}" if modelled.where and not modelled.line else modelled.reason


def simulated(name: str, environment: Environment) -> Simulated:
    """Return the simulated transport of this name."""
    return Simulated(VARIATIONS[name], environment)
