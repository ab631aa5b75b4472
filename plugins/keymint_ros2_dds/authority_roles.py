# SPDX-License-Identifier: Apache-2.0
"""The authorities that an enclave rests on: one issues identities, one signs permissions and governance."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import AuthorityRole, Implementation, Package
from keymint.errors import KeymintError
from keymint_ros2_dds.settings import settings_of

IDENTITY, PERMISSIONS = "identity", "permissions"
IMPLEMENTATIONS = (
    Implementation("cyclonedds", "Cyclone DDS 0.10", reissues=frozenset({IDENTITY})),
    Implementation("fastdds", "Fast DDS 2.9", bundles=frozenset({IDENTITY}), reissues=frozenset({IDENTITY})),
)
"""What vendors accept while an authority changes, measured. Cyclone DDS reads the first authority of a file only. Fast
DDS tells two authorities of one name that issued identities apart by their key identifiers, but verifies a document
with the first permissions authority of its name. A document is verified with exactly the certificate that signed it."""


def implementations() -> Sequence[Implementation]:
    """Return what was measured: see :meth:`keymint.api.AuthorityChanges.implementations`."""
    return IMPLEMENTATIONS


def authorities(package: Package) -> tuple[AuthorityRole, ...]:
    """Return the authorities of a package; see :meth:`keymint.api.BuildType.authorities`.

    Raises:
        KeymintError: permissions and governance have different issuers (DDS Security 1.1, 9.4.1: one permissions CA).
    """
    identity, grant = package.identity, package.grant
    governance = settings_of(package).governance
    if governance.issuer != grant.issuer:
        raise KeymintError(
            f"governance is signed by {governance.issuer!r}, permissions by {grant.issuer!r}, "
            "but participants verify both with one permissions authority",
            where=grant.origin,
            help="give both the same issuer_name",
            code="authority-mismatch",
        )
    return (
        AuthorityRole(IDENTITY, identity.issuer, identity.origin),
        AuthorityRole(PERMISSIONS, grant.issuer, grant.origin, signs=True),
    )
