# SPDX-License-Identifier: Apache-2.0
"""A package around the rules of a subject, where nothing but the rules matters."""

from __future__ import annotations

from datetime import UTC, datetime

from comarmor.errors import Origin
from keymint.api import CertificateSpec, DomainRange, Grant, KeySpec, Package, Validity
from keymint.ir import SubjectRules
from keymint.names import name_of
from keymint_ros2_dds.settings import BUILD_TYPE, DdsSettings, DomainRule, Governance

_VALIDITY = Validity(datetime(2000, 1, 1, tzinfo=UTC), datetime(2001, 1, 1, tzinfo=UTC))
"""Any period that documents can express: the findings on rules do not depend on it."""
_NAME = "CN=/subject"
"""Any subject name that is one: what names of subjects become is decided by the settings of a package."""
_EVERYWHERE = (DomainRange(0, 0),)
_ANYWHERE = Origin(BUILD_TYPE)
_PROTECTION = DomainRule(_EVERYWHERE, False, True, "ENCRYPT", "ENCRYPT", "ENCRYPT", (), _ANYWHERE)


def package_of(rules: SubjectRules, distro: str) -> Package:
    """Return a package with these rules, and with valid settings for all else."""
    subject = rules.subject
    origin = Origin(subject)
    return Package(
        name=name_of(subject),
        subject=subject,
        distro=distro,
        identity=CertificateSpec(_NAME, _VALIDITY, None, "identity", "SHA256", KeySpec("ec", "SECP256R1"), (), origin),
        grant=Grant("permissions", subject, _NAME, _VALIDITY, _EVERYWHERE, rules, origin),
        build_types=(BUILD_TYPE,),
        settings={BUILD_TYPE: DdsSettings(Governance("permissions", (_PROTECTION,)))},
    )
