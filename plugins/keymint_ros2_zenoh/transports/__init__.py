# SPDX-License-Identifier: Apache-2.0
"""Transports: Zenoh's access control about installed enclaves, as a model and as real routers and sessions.

Each is imported when it is opened.
"""

from __future__ import annotations

from functools import partial

from keymint.api import API_VERSION, TransportType, lazy

__all__ = ["real_zenoh", "zenoh_1"]

_zenoh = partial(TransportType, API_VERSION, "keymint_ros2_zenoh")

zenoh_1 = _zenoh(lazy("keymint_ros2_zenoh.transports.enclave_model:SimulatedZenoh"))
real_zenoh = _zenoh(lazy("keymint_ros2_zenoh.transports.real_transport:RealZenoh"))
