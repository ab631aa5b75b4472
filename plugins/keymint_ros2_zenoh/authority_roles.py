# SPDX-License-Identifier: Apache-2.0
"""The authorities that an enclave rests on: one issues identities, one signs the router's configuration."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import AuthorityRole, Implementation, Package

IDENTITY, ACCESS = "identity", "access"
_ALL = frozenset({IDENTITY, ACCESS})
IMPLEMENTATIONS = (Implementation("zenoh", "Zenoh 1", bundles=_ALL, reissues=_ALL),)
"""What Zenoh accepts while an authority changes: TLS trusts every authority of a file, by name and key. Only Keymint
verifies the signature of the router's configuration."""


def implementations() -> Sequence[Implementation]:
    """Return what was measured: see :meth:`keymint.api.AuthorityChanges.implementations`."""
    return IMPLEMENTATIONS


def authorities(package: Package) -> tuple[AuthorityRole, ...]:
    """Return the authorities of a package; see :meth:`keymint.api.BuildType.authorities`."""
    identity, grant = package.identity, package.grant
    return (
        AuthorityRole(IDENTITY, identity.issuer, identity.origin),
        AuthorityRole(ACCESS, grant.issuer, grant.origin, signs=True),
    )
