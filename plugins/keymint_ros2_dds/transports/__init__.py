# SPDX-License-Identifier: Apache-2.0
"""Transports: DDS implementations that decide about installed enclaves, simulated and real.

Simulated transports are always usable; real ones depend on the machine. Each is imported when it is opened.
"""

from __future__ import annotations

from functools import partial

from keymint.api.lazy import LazyTransport, lazy

__all__ = [
    "ardent_cyclonedds", "ardent_cyclonedds_0_10", "ardent_omg", "cyclonedds_0_10", "cyclonedds_11", "fastdds_2_9",
    "fastdds_2_11", "fastdds_3_3", "omg", "real_cyclonedds", "real_cyclonedds_0_10_5", "real_fastdds", "real_fastdds_3",
    "ros",
]  # fmt: skip

_SIMULATED = lazy("keymint_ros2_dds.transports.enclave_model:simulated_transport")
_ARDENT = lazy("keymint_ros2_dds.transports.ardent_middleware:ArdentMiddleware")
_dds = partial(LazyTransport, "keymint_ros2_dds")

omg = _dds(lambda environment: _SIMULATED("omg", environment))
cyclonedds_0_10 = _dds(lambda environment: _SIMULATED("cyclonedds-0.10", environment))
cyclonedds_11 = _dds(lambda environment: _SIMULATED("cyclonedds-11", environment))
fastdds_2_9 = _dds(lambda environment: _SIMULATED("fastdds-2.9", environment))
fastdds_2_11 = _dds(lambda environment: _SIMULATED("fastdds-2.11", environment))
fastdds_3_3 = _dds(lambda environment: _SIMULATED("fastdds-3.3", environment))
real_cyclonedds = _dds(lazy("keymint_ros2_dds.transports.participants_transport:CycloneDDSTransport"))
real_fastdds = _dds(lazy("keymint_ros2_dds.transports.participants_transport:FastDDSTransport"))
ros = _dds(lazy("keymint_ros2_dds.transports.ros_transport:RosTransport"))
real_fastdds_3 = _dds(lazy("keymint_ros2_dds.transports.participants_transport:FastDDS3Transport"))
real_cyclonedds_0_10_5 = _dds(lazy("keymint_ros2_dds.transports.participants_transport:CycloneDDS0105Transport"))
ardent_omg = _dds(lambda environment: _ARDENT(omg.open(environment)))
ardent_cyclonedds_0_10 = _dds(lambda environment: _ARDENT(cyclonedds_0_10.open(environment)))
ardent_cyclonedds = _dds(lambda environment: _ARDENT(real_cyclonedds.open(environment)))
