# SPDX-License-Identifier: Apache-2.0
"""The authorities that sign, each asked for its key only when something must be signed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from keymint.api import SigningAuthority
from keymint.authority.authorities import MintedAuthority


class Signers(Mapping[str, SigningAuthority]):
    """Signing authorities by role; access to one whose key is elsewhere raises a KeymintError that says so.

    Args:
        authorities: the authorities by role.
    """

    def __init__(self, authorities: Mapping[str, MintedAuthority]) -> None:
        self._authorities = authorities

    def __getitem__(self, role: str) -> SigningAuthority:
        return self._authorities[role].signer

    def __iter__(self) -> Iterator[str]:
        return iter(self._authorities)

    def __len__(self) -> int:
        return len(self._authorities)
