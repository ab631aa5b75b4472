# SPDX-License-Identifier: Apache-2.0
"""The real transport: routers and sessions of Zenoh in processes on loopback, with the installed files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby

from keymint.api import Availability, Enclave, Tier, Verdict
from keymint.api.graph import Edge
from keymint.host.vendor_transports import VendorTransport
from keymint_ros2_zenoh.transports.delivery import exchange
from keymint_ros2_zenoh.transports.enclave_model import InstalledModels
from keymint_ros2_zenoh.transports.logged_decisions import logged_decisions
from keymint_ros2_zenoh.transports.loopback_network import Network, running_network
from keymint_ros2_zenoh.vendors.zenoh_processes import installed_version

_Labeller = Callable[[Network, InstalledModels, Iterable[Edge]], Iterator[tuple[Edge, Verdict]]]


class RealZenoh(VendorTransport):
    """Implements :class:`keymint.api.Transport` with the library ``eclipse-zenoh``."""

    def _installed(self) -> Availability:
        return Availability(usable=True, version=installed_version(), tiers=tuple(Tier))

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        self.usable().require(tier, "zenoh")
        return self._label(exchange if tier is Tier.EXCHANGE else logged_decisions, enclaves, edges)

    def _label(
        self, label: _Labeller, enclaves: Sequence[Enclave], edges: Iterable[Edge]
    ) -> Iterator[tuple[Edge, Verdict]]:
        models = InstalledModels(enclaves, self._environment)
        for install, group in groupby(edges, key=lambda edge: models.enclaves[edge.subject].install):
            with running_network(models.router(install), self._environment.variables) as network:
                yield from label(network, models, group)
