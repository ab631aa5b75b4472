# SPDX-License-Identifier: Apache-2.0
"""Transports: DDS implementations that decide about installed enclaves, simulated and real.

Simulated transports are always usable; real ones depend on the machine. Each is imported when it is opened.
"""

from __future__ import annotations

from collections.abc import Callable

from keymint.api import API_VERSION, Environment, Transport
from keymint.api.lazy import lazy

__all__ = [
    "Opener", "ardent_cyclonedds", "ardent_cyclonedds_0_10", "ardent_omg", "cyclonedds_0_10", "fastdds_2_9", "omg",
    "real_cyclonedds", "real_fastdds",
]  # fmt: skip

_SIMULATED = lazy("keymint_ros2_dds.transports.simulated:simulated")
_ARDENT = lazy("keymint_ros2_dds.transports.ardent_middleware:ArdentMiddleware")


class Opener:
    """Implements :class:`keymint.api.TransportType`."""

    API = API_VERSION
    BUILD_TYPE = "keymint_ros2_dds"

    def __init__(self, make: Callable[[Environment], Transport]) -> None:
        self._make = make

    def open(self, environment: Environment) -> Transport:
        """Return the transport; ask it then whether it is usable."""
        return self._make(environment)


omg = Opener(lambda environment: _SIMULATED("omg", environment))
cyclonedds_0_10 = Opener(lambda environment: _SIMULATED("cyclonedds-0.10", environment))
fastdds_2_9 = Opener(lambda environment: _SIMULATED("fastdds-2.9", environment))
real_cyclonedds = Opener(lazy("keymint_ros2_dds.transports.cyclonedds_transport:CycloneDDSTransport"))
real_fastdds = Opener(lazy("keymint_ros2_dds.transports.participants_transport:FastDDSTransport"))
ardent_omg = Opener(lambda environment: _ARDENT(omg.open(environment)))
ardent_cyclonedds_0_10 = Opener(lambda environment: _ARDENT(cyclonedds_0_10.open(environment)))
ardent_cyclonedds = Opener(lambda environment: _ARDENT(real_cyclonedds.open(environment)))
