# SPDX-License-Identifier: Apache-2.0
"""The simulated transport: the model of Zenoh on installed files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from comarmor.values import dataclass
from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.api.graph import Edge
from keymint_ros2_zenoh.transports.enclave_model import InstalledModels


@dataclass(frozen=True, slots=True)
class Simulated:
    """Implements :class:`keymint.api.Transport` with the model of Zenoh 1.6 and later."""

    environment: Environment

    def usable(self) -> Availability:
        """Return that it is usable."""
        return Availability(usable=True, version="1", tiers=(Tier.DECISION,))

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        del tier
        models = InstalledModels(enclaves, self.environment)
        for edge in edges:
            yield edge, models.of(edge.subject).label(edge)
