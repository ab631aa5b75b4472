"""The installed Fast DDS 2.9: participants, or data between processes."""

from __future__ import annotations

from collections.abc import Mapping

from keymint.api import Availability, Tier
from keymint_ros2_dds.decision import FASTDDS_2_9
from keymint_ros2_dds.transports.participants_transport import RealTransport
from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.participants import FastDDS


class FastDDSTransport(RealTransport):
    """Fast DDS; its access control cannot be asked without a participant: tiers *decision* and *admission* are one."""

    NAME = "fastdds"
    MODEL = FASTDDS_2_9
    VENDOR = FastDDS
    PROBE = probe_builds.FASTDDS
    NONCONFORMING = probe_builds.FASTDDS_NONCONFORMING

    def _found(self, environment: Mapping[str, str]) -> Availability:
        """Fast DDS needs a compiler and headers."""
        try:
            probe_builds.FASTDDS.require(environment)
        except probe_builds.MissingVendorError as error:
            return Availability(usable=False, reason=error.reason, help=error.help)
        version = probe_builds.FASTDDS.version("fastrtps/config.h", "FASTRTPS_VERSION_STR", environment)
        return Availability(usable=True, version=version, tiers=tuple(Tier))
