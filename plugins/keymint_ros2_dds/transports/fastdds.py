"""Fast DDS 2.9, the real one: participants, or data between processes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property

from keymint.api import Enclave, Surroundings, Tier, Usable, Verdict
from keymint.errors import KeymintError
from keymint.graph import Edge
from keymint_ros2_dds.decision import FASTDDS_2_9
from keymint_ros2_dds.transports import real
from keymint_ros2_dds.transports.exchange import exchange
from keymint_ros2_dds.transports.simulated import Courts
from keymint_ros2_dds.vendors import probes
from keymint_ros2_dds.vendors.participants import FastDDS


class FastDDSTransport:
    """Implements :class:`keymint.api.Transport`.

    Fast DDS's access control cannot be asked without a participant, so the tiers *decision* and *admission* are one.
    """

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def usable(self) -> Usable:
        """Tell whether Fast DDS can be used here; it takes a compiler and headers."""
        return self._usable

    @cached_property
    def _usable(self) -> Usable:
        environment = self._surroundings.environment
        try:
            probes.FASTDDS.require(environment)
        except probes.MissingVendorError as error:
            return Usable(usable=False, reason=error.reason, help=error.help)
        version = probes.FASTDDS.version("fastrtps/config.h", "FASTRTPS_VERSION_STR", environment)
        return Usable(usable=True, version=version, tiers=tuple(Tier))

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        usable = self.usable()
        if tier not in usable.tiers:
            raise real.refused(tier, usable, "fastdds")
        courts = Courts(enclaves, self._surroundings.now)
        vendor = self._vendor(nonconforming=tier is Tier.EXCHANGE)
        if tier is Tier.EXCHANGE:
            return exchange(vendor, FASTDDS_2_9, courts, enclaves, edges)
        return real.admission(vendor, FASTDDS_2_9, courts, edges)

    def _vendor(self, *, nonconforming: bool) -> FastDDS:
        cache, environment = self._surroundings.cache / "probes", probes.inherited(self._surroundings.environment)
        try:
            return FastDDS(
                probes.FASTDDS.build(cache, environment),
                environment,
                probes.FASTDDS_NONCONFORMING.build(cache, environment) if nonconforming else None,
            )
        except (probes.MissingVendorError, OSError) as error:
            raise KeymintError(str(error), code="transport-unusable") from None
