# SPDX-License-Identifier: Apache-2.0
"""Transports: DDS implementations that decide about installed enclaves, simulated and real.

Simulated transports are always usable; real ones depend on the machine. Each is imported when it is opened.
"""

from __future__ import annotations

from functools import partial

from keymint.api import API_VERSION, TransportType, lazy

_SIMULATED = lazy("keymint_ros2_dds.transports.enclave_model:Simulated")
_ARDENT = lazy("keymint_ros2_dds.transports.ardent_middleware:ArdentMiddleware")
_PARTICIPANTS = lazy("keymint_ros2_dds.transports.real_transports:ParticipantsTransport")
_PLUGIN = lazy("keymint_ros2_dds.transports.real_transports:CycloneDDSTransport")
_dds = partial(TransportType, API_VERSION, "keymint_ros2_dds")

omg = _dds(partial(_SIMULATED, "omg"))
cyclonedds_0_10 = _dds(partial(_SIMULATED, "cyclonedds-0.10"))
cyclonedds_11 = _dds(partial(_SIMULATED, "cyclonedds-11"))
fastdds_2_9 = _dds(partial(_SIMULATED, "fastdds-2.9"))
fastdds_2_11 = _dds(partial(_SIMULATED, "fastdds-2.11"))
fastdds_3_3 = _dds(partial(_SIMULATED, "fastdds-3.3"))
real_cyclonedds = _dds(partial(_PLUGIN, "cyclonedds"))
real_fastdds = _dds(partial(_PARTICIPANTS, "fastdds"))
ros = _dds(lazy("keymint_ros2_dds.transports.real_transports:RosTransport"))
real_fastdds_3 = _dds(partial(_PARTICIPANTS, "fastdds-3"))
real_cyclonedds_0_10_5 = _dds(partial(_PARTICIPANTS, "cyclonedds-0.10.5"))
ardent_omg = _dds(lambda environment: _ARDENT(omg.open(environment)))
ardent_cyclonedds_0_10 = _dds(lambda environment: _ARDENT(cyclonedds_0_10.open(environment)))
ardent_cyclonedds = _dds(lambda environment: _ARDENT(real_cyclonedds.open(environment)))
