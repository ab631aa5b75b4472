# SPDX-License-Identifier: Apache-2.0
"""The authorities that an enclave rests on: one issues identities, one signs permissions and governance."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import AuthorityRole, Implementation, Package

IDENTITY, PERMISSIONS = "identity", "permissions"
IMPLEMENTATIONS = (
    Implementation("cyclonedds", "Cyclone DDS 0.10", reissues=frozenset({IDENTITY})),
    Implementation("fastdds", "Fast DDS 2.9", bundles=frozenset({IDENTITY}), reissues=frozenset({IDENTITY})),
)
"""What vendors accept while an authority changes, measured. Cyclone DDS reads the first authority of a file only. Fast
DDS tells two authorities of one name that issued identities apart by their key identifiers, but verifies a document
with the first permissions authority of its name. A document is verified with exactly the certificate that signed it."""


def implementations() -> Sequence[Implementation]:
    """Return what was measured: see :meth:`keymint.api.BuildType.implementations`."""
    return IMPLEMENTATIONS


def authorities(package: Package) -> tuple[AuthorityRole, ...]:
    """Return the authorities of a package; see :meth:`keymint.api.BuildType.authorities`.

    Its permissions authority signs the governance as well (DDS Security 1.1, 9.4.1): no other sources are loaded, see
    :func:`keymint_ros2_dds.governance_source.settings`.
    """
    identity, grant = package.identity, package.grant
    return (
        AuthorityRole(IDENTITY, identity.issuer, identity.origin),
        AuthorityRole(PERMISSIONS, grant.issuer, grant.origin, signs=True),
    )
