# SPDX-License-Identifier: Apache-2.0
"""Blocks of UDP ports on loopback, so that systems of tests with the same domain id never communicate."""

from __future__ import annotations

import random
import socket
from typing import Self

PORTS = 40
"""Ports of a system: the first ten are not for participants, each of which then has two (RTPS 2.2, 9.6.1.1)."""
FIRST_PARTICIPANT = 10


class Ports:
    """A block of UDP ports on loopback that no other system uses, in this process or another.

    The ports are below the kernel's ephemeral range. One port that no participant uses stays bound as long as the
    system exists; whoever binds it owns the block.

    Attributes:
        first: the first port.

    Raises:
        OSError: no block is free.
    """

    _GUARD = 5
    _RANGE = range(20_000, 32_000, PORTS)

    def __init__(self) -> None:
        self.first, self._guard = self._claim()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._guard.close()

    def _claim(self) -> tuple[int, socket.socket]:
        for first in random.sample(self._RANGE, len(self._RANGE)):
            guard = _bound(first + self._GUARD)
            if guard is None:
                continue
            others = [_bound(first + offset) for offset in range(PORTS) if offset != self._GUARD]
            for other in others:
                if other is not None:
                    other.close()
            if None not in others:
                return first, guard
            guard.close()
        raise OSError("no free block of UDP ports on loopback")


def _bound(port: int) -> socket.socket | None:
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.bind(("127.0.0.1", port))
    except OSError:
        bound.close()
        return None
    return bound
