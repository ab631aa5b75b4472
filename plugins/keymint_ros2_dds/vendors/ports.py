# SPDX-License-Identifier: Apache-2.0
"""Blocks of UDP ports on loopback, so that systems of tests with the same domain id never communicate."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

PORTS = 40
"""Ports of a system: the first ten are not for participants, each of which then has two (RTPS 2.2, 9.6.1.1)."""
FIRST_PARTICIPANT = 10
_GUARD = 5
_RANGE = range(20_000, 32_000, PORTS)
"""First ports of the blocks, below the kernel's ephemeral range."""


@contextmanager
def free_ports() -> Iterator[int]:
    """Yield the first of a block of UDP ports on loopback that no other system uses, in this process or another.

    One port that no participant uses stays bound as long as the context; whoever binds it owns the block.

    Raises:
        OSError: no block is free.
    """
    for first in random.sample(_RANGE, len(_RANGE)):
        guard = _bound(first + _GUARD)
        if guard is None:
            continue
        with guard:
            others = [_bound(first + offset) for offset in range(PORTS) if offset != _GUARD]
            for other in filter(None, others):
                other.close()
            if None not in others:
                yield first
                return
    raise OSError("no free block of UDP ports on loopback")


def _bound(port: int) -> socket.socket | None:
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.bind(("127.0.0.1", port))
    except OSError:
        bound.close()
        return None
    return bound
