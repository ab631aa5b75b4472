# SPDX-License-Identifier: Apache-2.0
"""The real transport: routers and sessions of Zenoh in processes on loopback, with the installed files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import groupby

from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.api.graph import Edge
from keymint.host.vendor_process import MissingVendorError
from keymint_ros2_zenoh.transports.delivery import exchange
from keymint_ros2_zenoh.transports.enclave_model import InstalledModels
from keymint_ros2_zenoh.transports.logged_decisions import logged_decisions
from keymint_ros2_zenoh.transports.loopback_network import Network, running
from keymint_ros2_zenoh.vendors.zenoh_library import installed_version

_Labeller = Callable[[Network, InstalledModels, Iterable[Edge]], Iterator[tuple[Edge, Verdict]]]


class RealZenoh:
    """Implements :class:`keymint.api.Transport` with the library ``eclipse-zenoh``.

    Args:
        environment: the environment variables for its processes.
    """

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def usable(self) -> Availability:
        """Return whether the library is installed; determined once."""
        return self._usable

    @cached_property
    def _usable(self) -> Availability:
        try:
            return Availability(usable=True, version=installed_version(), tiers=tuple(Tier))
        except MissingVendorError as error:
            return Availability(usable=False, reason=error.reason, help=error.help)

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        self.usable().require(tier, "zenoh")
        return self._label(exchange if tier is Tier.EXCHANGE else logged_decisions, enclaves, edges)

    def _label(
        self, label: _Labeller, enclaves: Sequence[Enclave], edges: Iterable[Edge]
    ) -> Iterator[tuple[Edge, Verdict]]:
        models = InstalledModels(enclaves, self._environment)
        for install, group in groupby(edges, key=lambda edge: models.enclaves[edge.subject].install):
            with running(models.router(install), self._environment.variables) as network:
                yield from label(network, models, group)
