# SPDX-License-Identifier: Apache-2.0
"""Transports: Zenoh's access control about installed enclaves, as a model and as real routers and sessions.

Each is imported when it is opened.
"""

from __future__ import annotations

from keymint.api.lazy import LazyTransport, lazy

__all__ = ["real_zenoh", "zenoh_1"]

zenoh_1 = LazyTransport("keymint_ros2_zenoh", lazy("keymint_ros2_zenoh.transports.enclave_model:SimulatedZenoh"))
real_zenoh = LazyTransport("keymint_ros2_zenoh", lazy("keymint_ros2_zenoh.transports.real_transport:RealZenoh"))
