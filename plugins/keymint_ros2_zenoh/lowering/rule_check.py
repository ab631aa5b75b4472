# SPDX-License-Identifier: Apache-2.0
"""What Zenoh cannot express of the rules of a subject, and of its package."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.errors import Defects, Diagnostic
from keymint.api import Package
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint_ros2_zenoh.lowering.key_rules import Lowered, lower, lower_notes
from keymint_ros2_zenoh.lowering.name_rules import name_rules


def check_rules(rules: SubjectRules, distro: str) -> Sequence[Diagnostic]:
    """Return rules that Zenoh cannot express, that hold for literal keys only, or that match no name.

    Args:
        rules: the policy's rules for a subject.
        distro: ROS 2 distribution whose name mapping applies.
    """
    try:
        return tuple(lower_notes(name_rules(rules, distro)))
    except KeymintError as error:
        return error.diagnostics


def lower_package(package: Package) -> Lowered:
    """Return what a router must permit or deny on the link of a package's subject.

    Raises:
        KeymintError: Zenoh cannot express a rule or the validity of the grant; all defects with their ``file:line``.
    """
    defects, grant = Defects(), package.grant
    defects.found += _dated(package)
    with defects:
        lowered = lower(grant.rules, package.distro, grant.domains, grant.domains_origin or grant.origin)
    defects.require_none()
    return lowered


def _dated(package: Package) -> Iterator[Diagnostic]:
    """Yield an error for rights that begin later or end earlier than the certificate of the subject."""
    rights, identity = package.grant.validity, package.identity.validity
    if rights is None:
        return
    if rights.not_before > identity.not_before or rights.not_after < identity.not_after:
        yield Diagnostic.error(
            "zenoh-validity",
            "the permissions are valid for a shorter time than the certificate, but rights on Zenoh have no dates: "
            "they end with the certificate",
            package.grant.origin,
            "give the certificate the same validity, or leave out that of the permissions",
            package.subject,
        )
