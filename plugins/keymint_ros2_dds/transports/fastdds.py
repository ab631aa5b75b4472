"""Fast DDS 2.9, the real one: participants, or data between processes."""

from __future__ import annotations

from collections.abc import Mapping

from keymint.api import Tier, Usable
from keymint_ros2_dds.decision import FASTDDS_2_9
from keymint_ros2_dds.transports.real_transport import RealTransport
from keymint_ros2_dds.vendors import probes
from keymint_ros2_dds.vendors.participants import FastDDS


class FastDDSTransport(RealTransport):
    """Fast DDS; its access control cannot be asked without a participant: tiers *decision* and *admission* are one."""

    NAME = "fastdds"
    MODEL = FASTDDS_2_9
    VENDOR = FastDDS
    PROBE = probes.FASTDDS
    NONCONFORMING = probes.FASTDDS_NONCONFORMING

    def _found(self, environment: Mapping[str, str]) -> Usable:
        """It takes a compiler and headers."""
        try:
            probes.FASTDDS.require(environment)
        except probes.MissingVendorError as error:
            return Usable(usable=False, reason=error.reason, help=error.help)
        version = probes.FASTDDS.version("fastrtps/config.h", "FASTRTPS_VERSION_STR", environment)
        return Usable(usable=True, version=version, tiers=tuple(Tier))
