# SPDX-License-Identifier: Apache-2.0
"""What a package says about DDS beside its rules: the governance, which protects domains and topics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import DomainRange, Grant, Package, Validity
from keymint.api.source_documents import incomplete

BUILD_TYPE = "keymint_ros2_dds"
"""The name by which packages ask for this build type."""
STRICT_DOMAIN: Mapping[str, Any] = {
    "allow_unauthenticated_participants": False,
    "enable_join_access_control": True,
    "discovery_protection_kind": "ENCRYPT",
    "liveliness_protection_kind": "ENCRYPT",
    "rtps_protection_kind": "SIGN",
}
"""Settings of a domain rule in the order of a document, and what holds where neither a package nor its defaults say."""
STRICT_TOPIC: Mapping[str, Any] = {
    "enable_discovery_protection": True,
    "enable_liveliness_protection": True,
    "enable_read_access_control": True,
    "enable_write_access_control": True,
    "metadata_protection_kind": "ENCRYPT",
    "data_protection_kind": "ENCRYPT",
}
"""The same for a topic rule."""


@dataclass(frozen=True, slots=True)
class TopicProtection:
    """A topic rule of a governance document (DDS Security 1.1, 9.4.1.2.5).

    Attributes:
        kind: ``topic`` for a raw DDS topic expression, or ``ros_topic``, ``ros_service``, ``ros_action``,
            ``ros_parameter`` for an expression over ROS names.
        expression: POSIX ``fnmatch`` expression.
        metadata_protection_kind: NONE, SIGN, ENCRYPT, SIGN_WITH_ORIGIN_AUTHENTICATION, ENCRYPT_WITH_….
        data_protection_kind: NONE, SIGN or ENCRYPT.
        origin: where it is written; rules that are written in two places may be equal.
    """

    kind: str
    expression: str
    enable_discovery_protection: bool
    enable_liveliness_protection: bool
    enable_read_access_control: bool
    enable_write_access_control: bool
    metadata_protection_kind: str
    data_protection_kind: str
    origin: Origin = field(compare=False)


@dataclass(frozen=True, slots=True)
class DomainRule:
    """A domain rule of a governance document (DDS Security 1.1, 9.4.1.2.4).

    Attributes:
        origin: where it is written; rules that are written in two places may be equal.
        domains_origin: where its domains are written, if not at ``origin``.
    """

    domains: tuple[DomainRange, ...]
    allow_unauthenticated_participants: bool
    enable_join_access_control: bool
    discovery_protection_kind: str
    liveliness_protection_kind: str
    rtps_protection_kind: str
    topic_rules: tuple[TopicProtection, ...]
    origin: Origin = field(compare=False)
    domains_origin: Origin | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Governance:
    """The protection of domains and topics.

    Attributes:
        issuer: name of the authority that signs the document.
        domain_rules: in order; the first that applies to a domain counts.
        accepts_open: the profile accepts rules that disable access control of topics or of joining a domain.
    """

    issuer: str
    domain_rules: tuple[DomainRule, ...]
    accepts_open: bool = False


@dataclass(frozen=True, slots=True)
class DdsSettings:
    """The payload of this build type in a package.

    Attributes:
        governance: the protection of domains and topics.
        accepts_token_keys: the profile accepts identities whose keys only one vendor reads.
    """

    governance: Governance
    accepts_token_keys: bool = False


def settings_of(package: Package) -> DdsSettings:
    """Return what this build type read from the sources of a package that it builds."""
    settings = package.settings[BUILD_TYPE]
    if not isinstance(settings, DdsSettings):
        raise TypeError(f"the settings of {package.name} are those of another build type")
    return settings


def validity_of(grant: Grant) -> Validity:
    """Return the period in which a grant is valid, which every grant of DDS has (DDS Security 1.1, 9.4.1.3).

    Raises:
        KeymintError: the sources give none.
    """
    if grant.validity is None:
        raise incomplete("grant", "validity", grant.defaults_origin or grant.origin)
    return grant.validity
