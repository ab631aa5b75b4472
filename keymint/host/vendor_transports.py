# SPDX-License-Identifier: Apache-2.0
"""Transports with the real software of a vendor, which this machine may not have."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

from keymint.api.transports import Availability, Environment
from keymint.host.vendor_process import MissingVendorError


class VendorTransport(ABC):
    """What such transports have in common; a subclass has the other methods of :class:`keymint.api.Transport`.

    Args:
        environment: the cache, and the environment variables of processes.
    """

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def usable(self) -> Availability:
        """Return whether it can be used here; determined once."""
        return self._usable

    @cached_property
    def _usable(self) -> Availability:
        try:
            return self._installed()
        except MissingVendorError as error:
            return Availability(usable=False, reason=error.reason, help=error.help)

    @abstractmethod
    def _installed(self) -> Availability:
        """Look for the vendor's software.

        Raises:
            MissingVendorError: it is not there, or too old.
        """
