# SPDX-License-Identifier: Apache-2.0
"""Source packages: identity, permissions and governance of one subject."""

from __future__ import annotations

from dataclasses import dataclass

from comarmor.errors import Origin
from keymint.api.certificates import Authority, CertificateSpec, Validity
from keymint.ir import SubjectRules


@dataclass(frozen=True, slots=True, order=True)
class DomainRange:
    """DDS domain ids from ``first`` to ``last``, both included."""

    first: int
    last: int


@dataclass(frozen=True, slots=True)
class TopicProtection:
    """A topic rule of a governance document (DDS Security 1.1, 9.4.1.2.5).

    Attributes:
        kind: ``topic`` for a raw DDS topic expression, or ``ros_topic``, ``ros_service``, ``ros_action``,
            ``ros_parameter`` for an expression over ROS names.
        expression: POSIX ``fnmatch`` expression.
        metadata_protection_kind: NONE, SIGN, ENCRYPT, SIGN_WITH_ORIGIN_AUTHENTICATION, ENCRYPT_WITH_….
        data_protection_kind: NONE, SIGN or ENCRYPT.
    """

    kind: str
    expression: str
    enable_discovery_protection: bool
    enable_liveliness_protection: bool
    enable_read_access_control: bool
    enable_write_access_control: bool
    metadata_protection_kind: str
    data_protection_kind: str
    origin: Origin


@dataclass(frozen=True, slots=True)
class DomainRule:
    """A domain rule of a governance document (DDS Security 1.1, 9.4.1.2.4).

    Attributes:
        domains_origin: where its domains are written, if not at ``origin``.
    """

    domains: tuple[DomainRange, ...]
    allow_unauthenticated_participants: bool
    enable_join_access_control: bool
    discovery_protection_kind: str
    liveliness_protection_kind: str
    rtps_protection_kind: str
    topic_rules: tuple[TopicProtection, ...]
    origin: Origin
    domains_origin: Origin | None = None


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
class Grant:
    """The grant of a subject: its rules, domains and validity.

    Attributes:
        issuer: name of the authority that signs the document.
        name: the grant's name attribute.
        subject_name: distinguished name as text; must equal that of the identity.
        domains: domains in which the grant is valid.
        domains_origin: where these are written, if not at ``origin``.
        edited: the rules were edited by hand and differ from the policy.
    """

    issuer: str
    name: str
    subject_name: str
    validity: Validity
    domains: tuple[DomainRange, ...]
    rules: SubjectRules
    origin: Origin
    domains_origin: Origin | None = None
    edited: bool = False


@dataclass(frozen=True, slots=True)
class Package:
    """A loaded source package: the input of a build type for one subject.

    Attributes:
        name: package name, e.g. ``robot1/arm/driver`` (its folder under the source space).
        subject: ``"/" + name``.
        build_type: name of the plugin that builds it.
        distro: ROS 2 distribution whose name mapping applies.
        identity: the subject's certificate.
        issuers: the chain of authorities from the identity's issuer up to the root.
    """

    name: str
    subject: str
    build_type: str
    distro: str
    identity: CertificateSpec
    grant: Grant
    governance: Governance
    issuers: tuple[Authority, ...] = ()
