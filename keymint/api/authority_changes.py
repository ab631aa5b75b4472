# SPDX-License-Identifier: Apache-2.0
"""What the implementations of a transport accept while the key or the certificate of an authority changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from comarmor.values import dataclass


@dataclass(frozen=True, slots=True)
class Implementation:
    """An implementation of a transport, as it was measured.

    Attributes:
        name: short name, lower case, for the command line.
        title: its name and version.
        bundles: the roles of authorities (:attr:`keymint.api.AuthorityRole.role`) in which subjects may trust two
            authorities at once, if these have key identifiers.
        reissues: the roles in which subjects that have the old certificate of a key, and subjects that have a new one,
            accept each other.
    """

    name: str
    title: str
    bundles: frozenset[str] = frozenset()
    reissues: frozenset[str] = frozenset()


@runtime_checkable
class AuthorityChanges(Protocol):
    """Optional capability of a build type: tells how the authorities of installed enclaves can be changed.

    Of a transport without it, nothing is assumed: all subjects change together.
    """

    def implementations(self) -> Sequence[Implementation]:
        """Return the implementations of the transport that were measured."""
