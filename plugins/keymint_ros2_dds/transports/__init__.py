"""Transports: DDS implementations that decide about installed enclaves, simulated and real.

Simulated transports are always usable; real ones depend on the machine. Each is imported when it is opened.
"""

from __future__ import annotations

from collections.abc import Callable

from keymint.api import API_VERSION, Environment, Transport

__all__ = [
    "Opener", "ardent_cyclonedds", "ardent_cyclonedds_0_10", "ardent_omg", "cyclonedds_0_10", "fastdds_2_9", "omg",
    "real_cyclonedds", "real_fastdds",
]  # fmt: skip


class Opener:
    """Implements :class:`keymint.api.TransportType`."""

    API = API_VERSION

    def __init__(self, make: Callable[[Environment], Transport]) -> None:
        self._make = make

    def open(self, environment: Environment) -> Transport:
        """Return the transport; ask it then whether it is usable."""
        return self._make(environment)


def _simulated(name: str) -> Opener:
    def make(environment: Environment) -> Transport:
        from keymint_ros2_dds.transports.simulated import Simulated  # noqa: PLC0415 - listing plugins loads no XML

        return Simulated.of(name, environment)

    return Opener(make)


def _cyclonedds(environment: Environment) -> Transport:
    from keymint_ros2_dds.transports.cyclonedds_transport import CycloneDDSTransport  # noqa: PLC0415

    return CycloneDDSTransport(environment)


def _fastdds(environment: Environment) -> Transport:
    from keymint_ros2_dds.transports.fastdds_transport import FastDDSTransport  # noqa: PLC0415

    return FastDDSTransport(environment)


def _of_ardent(opener: Opener) -> Opener:
    def make(environment: Environment) -> Transport:
        from keymint_ros2_dds.transports.ardent_middleware import ArdentMiddleware  # noqa: PLC0415

        return ArdentMiddleware(opener.open(environment))

    return Opener(make)


omg = _simulated("omg")
cyclonedds_0_10 = _simulated("cyclonedds-0.10")
fastdds_2_9 = _simulated("fastdds-2.9")
real_cyclonedds = Opener(_cyclonedds)
real_fastdds = Opener(_fastdds)
ardent_omg = _of_ardent(omg)
ardent_cyclonedds_0_10 = _of_ardent(cyclonedds_0_10)
ardent_cyclonedds = _of_ardent(real_cyclonedds)
