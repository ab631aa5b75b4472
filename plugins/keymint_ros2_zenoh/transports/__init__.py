# SPDX-License-Identifier: Apache-2.0
"""Transports: Zenoh's access control about installed enclaves, as a model and as real routers and sessions.

Each is imported when it is opened.
"""

from __future__ import annotations

from keymint.api import API_VERSION, Environment, Transport
from keymint.api.lazy import lazy

__all__ = ["Opener", "real_zenoh", "zenoh_1"]


class Opener:
    """Implements :class:`keymint.api.TransportType`."""

    API = API_VERSION
    BUILD_TYPE = "keymint_ros2_zenoh"

    def __init__(self, target: str) -> None:
        self._make = lazy(target).__func__

    def open(self, environment: Environment) -> Transport:
        """Return the transport; ask it then whether it is usable."""
        transport: Transport = self._make(environment)
        return transport


zenoh_1 = Opener("keymint_ros2_zenoh.transports.simulated:Simulated")
real_zenoh = Opener("keymint_ros2_zenoh.transports.real:RealZenoh")
