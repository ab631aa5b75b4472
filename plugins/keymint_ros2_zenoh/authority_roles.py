# SPDX-License-Identifier: Apache-2.0
"""The authorities that an enclave rests on: one issues identities, one signs the router's configuration."""

from __future__ import annotations

from keymint.api import AuthorityRole, Package

IDENTITY, ACCESS = "identity", "access"


def authorities(package: Package) -> tuple[AuthorityRole, ...]:
    """Return the authorities of a package; see :meth:`keymint.api.BuildType.authorities`."""
    identity, grant = package.identity, package.grant
    return (
        AuthorityRole(IDENTITY, identity.issuer, identity.origin),
        AuthorityRole(ACCESS, grant.issuer, grant.origin, signs=True),
    )
