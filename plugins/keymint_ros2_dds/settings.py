# SPDX-License-Identifier: Apache-2.0
"""What a package says about DDS beside its rules: the governance, which protects domains and topics.

It is read from a package's document and its defaults.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

from comarmor.text import quote
from comarmor.values import Data, defaults_of, field, replace
from comarmor.xml.reader import line
from keymint import api
from keymint.api.source_documents import DEFAULT_DOMAINS, Reader, domains, incomplete, signer, text
from keymint.errors import Defects, KeymintError, Origin
from keymint.ir import SubjectRules
from keymint.names import name_of

if TYPE_CHECKING:
    from lxml import etree

BUILD_TYPE = "keymint_ros2_dds"
"""The name by which packages ask for this build type."""


class TopicProtection(Data):
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
    origin: Origin = field(compare=False)
    enable_discovery_protection: bool = True
    enable_liveliness_protection: bool = True
    enable_read_access_control: bool = True
    enable_write_access_control: bool = True
    metadata_protection_kind: str = "ENCRYPT"
    data_protection_kind: str = "ENCRYPT"


class DomainRule(Data):
    """A domain rule of a governance document (DDS Security 1.1, 9.4.1.2.4).

    Attributes:
        origin: where it is written; rules that are written in two places may be equal.
        domains_origin: where its domains are written, if not at ``origin``.
    """

    domains: tuple[api.DomainRange, ...]
    topic_rules: tuple[TopicProtection, ...]
    origin: Origin = field(compare=False)
    domains_origin: Origin | None = field(default=None, compare=False)
    allow_unauthenticated_participants: bool = False
    enable_join_access_control: bool = True
    discovery_protection_kind: str = "ENCRYPT"
    liveliness_protection_kind: str = "ENCRYPT"
    rtps_protection_kind: str = "SIGN"


def _strict(rule: type[TopicProtection | DomainRule]) -> Mapping[str, Any]:
    return {name: default for name, default in defaults_of(rule).items() if default is not None}


STRICT_DOMAIN, STRICT_TOPIC = _strict(DomainRule), _strict(TopicProtection)
"""Settings in the order of a document, and what holds where neither a package nor its defaults say."""


class DdsSettings(Data):
    """The payload of this build type in a package: the protection of domains and topics.

    Attributes:
        issuer: name of the authority that signs the governance.
        domain_rules: in order; the first that applies to a domain counts.
        accepts_open: the profile accepts rules that disable access control of topics or of joining a domain.
        accepts_token_keys: the profile accepts identities whose keys only one vendor reads.
    """

    issuer: str
    domain_rules: tuple[DomainRule, ...]
    accepts_open: bool = False
    accepts_token_keys: bool = False


def settings_of(package: api.Package) -> DdsSettings:
    """Return what this build type read from the sources of a package that it builds."""
    settings = package.settings[BUILD_TYPE]
    if not isinstance(settings, DdsSettings):
        raise TypeError(f"the settings of {package.name} are those of another build type")
    return settings


def validity_of(grant: api.Grant) -> api.Validity:
    """Return the period in which a grant is valid, which every grant of DDS has (DDS Security 1.1, 9.4.1.3).

    Raises:
        KeymintError: the sources give none.
    """
    if grant.validity is None:
        raise incomplete("grant", "validity", grant.defaults_origin or grant.origin)
    return grant.validity


_VALIDITY = api.Validity(datetime(2000, 1, 1, tzinfo=UTC), datetime(2001, 1, 1, tzinfo=UTC))
"""Any period that documents can express: the findings on rules do not depend on it."""
_NAME = "CN=/subject"
"""Any subject name that is one: what names of subjects become is decided by the settings of a package."""
_EVERYWHERE = (api.DomainRange(0, 0),)
_ANYWHERE = Origin(BUILD_TYPE)
_TOPICS = (TopicProtection("topic", "*", _ANYWHERE),)
_PROTECTION = DomainRule(_EVERYWHERE, _TOPICS, _ANYWHERE, rtps_protection_kind="ENCRYPT")


def package_of(rules: SubjectRules, distro: str) -> api.Package:
    """Return a package with these rules, and with valid settings for all else."""
    subject = rules.subject
    origin, key = Origin(subject), api.KeySpec("ec", "SECP256R1")
    return api.Package(
        name=name_of(subject),
        subject=subject,
        distro=distro,
        identity=api.CertificateSpec(_NAME, _VALIDITY, None, "identity", "SHA256", key, (), origin),
        grant=api.Grant("permissions", subject, _NAME, _VALIDITY, _EVERYWHERE, rules, origin),
        build_types=(BUILD_TYPE,),
        settings={BUILD_TYPE: DdsSettings("permissions", (_PROTECTION,))},
    )


PART = "governance"
"""Name of the part of a package that this module reads."""
OPEN_GOVERNANCE = "open_governance"
"""What a profile accepts that leaves topics without access control."""
KEY_URIS = "token_keys"
"""What a profile accepts that only participants of Fast DDS can use."""


def settings(sources: api.PackageSources) -> api.PackageSettings:
    """Return the governance of a package: see :meth:`keymint.api.BuildType.settings`.

    Raises:
        KeymintError: with ``file:line`` of each defect, also of a grant that is incomplete for DDS.
    """
    defects = Defects()
    governance = defects.attempt(partial(_governance, sources, sources.parts[PART]))
    grant = sources.grant
    if grant and (not grant.subject_name or grant.validity is None):  # it must have both (DDS Security 1.1, 9.4.1.3)
        missing = "validity" if grant.subject_name else "subject_name"
        defects.found += incomplete("grant", missing, grant.defaults_origin or grant.origin).diagnostics
    if governance is None or defects.found:
        raise KeymintError.of(defects.found)
    if grant and grant.issuer != governance.issuer:
        message = f"permissions are signed by {grant.issuer!r}, governance by {governance.issuer!r}"
        help_ = "use the same authority for both: a DDS participant verifies both with one certificate"
        raise KeymintError(message, where=sources.parts[PART].where, help=help_, code="signers-differ")
    return api.PackageSettings(governance)


def _governance(sources: api.PackageSources, part: api.SourcePart) -> DdsSettings:
    own = None if part.content is None else _read(part.content, part.file)
    if part.defaults is None:
        message = f"there is no file {quote(part.defaults_file, 200)} in the package or its profile"
        raise KeymintError(message, where=part.where, help="create it, or correct the path", code="file-missing")
    base, _, defaults_issuer = _base(part.defaults, part.defaults_file)
    usual = defaults_issuer or (sources.grant.issuer if sources.grant else "")
    issuer = signer(part.issuer, part.where, usual, base.origin, sources.authorities)
    rules = tuple(_in_file(each, part.file) for each in _domain_rules(own, part.defaults, part.defaults_file))
    return DdsSettings(issuer, rules or (base,), OPEN_GOVERNANCE in sources.accepts, KEY_URIS in sources.accepts)


def _settings(element: etree._Element, known: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings that an element gives: kinds of protection as text, others as booleans."""
    return {
        str(part.tag): text(part) if str(part.tag).endswith("_kind") else text(part) in {"true", "1"}
        for part in element
        if part.tag in known
    }


def _checked(root: etree._Element) -> etree._Element:
    """Return a document whose ranges of domains are in order.

    Raises:
        KeymintError: one is not; with its line.
    """
    for element in root.iter("domains"):
        domains(element)
    return root


_read = Reader("keymint_ros2_dds", "source_governance", _checked, ("governance_documents", "package"))
"""Reads the governance of a package."""
_read_defaults = Reader(
    "keymint_ros2_dds", "source_governance_defaults", _checked, ("governance_documents", "defaults")
)
"""Reads the defaults of a domain rule."""


@lru_cache(maxsize=64)
def _base(content: bytes, file: str) -> tuple[DomainRule, Mapping[str, Any], str]:
    """Return the domain rule that the defaults describe, their settings for every topic, and the issuer, if any.

    Args:
        content: the defaults. If a package has no domain rules, theirs is the only one.
        file: their document, for origins.
    """
    root = _read_defaults(content, file)
    rule = DomainRule(
        domains=domains(root.find("domains")) or DEFAULT_DOMAINS,
        topic_rules=(),
        origin=Origin(file, line(root)),
        **_settings(root, STRICT_DOMAIN),
    )
    topics = root.findall("topic_access_rules/*")
    general: Mapping[str, Any] = next(
        (_settings(topic, STRICT_TOPIC) for topic in topics if _kind_and_expression(topic) == ("topic", "*")), {}
    )
    rules = tuple(_topic_protection(topic, general, file) for topic in topics)
    return replace(rule, topic_rules=rules), general, text(root.find("issuer_name")) or ""


@lru_cache(maxsize=64)
def _domain_rules(own: etree._Element | None, defaults: bytes, file: str) -> tuple[DomainRule, ...]:
    """Return the domain rules of packages with the same documents, without the names of their own.

    Args:
        own: the document of the packages; None if they have none.
        defaults: the defaults of these rules.
        file: the document of the defaults, for origins.
    """
    base, general, _ = _base(defaults, file)
    elements = () if own is None else own.iterfind("domain_access_rules/domain_rule")
    return tuple(_domain_rule(element, base, general) for element in elements)


def _in_file(rule: DomainRule, file: str) -> DomainRule:
    """Return a domain rule of a document, which was read without a look at its path."""
    own = [replace(each, origin=Origin(file, each.origin.line)) for each in rule.topic_rules if not each.origin.file]
    topics = (*own, *rule.topic_rules[len(own) :]) if own else rule.topic_rules
    return replace(rule, topic_rules=topics, origin=Origin(file, rule.origin.line))


def _domain_rule(element: etree._Element, base: DomainRule, general: Mapping[str, Any]) -> DomainRule:
    """Return the domain rule that a package and its defaults describe together; its own places have no file.

    A domain rule's own topic rules come before those of the defaults, since the first one that matches a topic decides.
    A topic rule takes the settings that it leaves out from the defaults' rule for every topic.

    Args:
        element: the package's ``<domain_rule>``.
        base: the domain rule of the defaults.
        general: settings of the defaults for every topic.
    """
    own_domains = domains(element.find("domains"))
    own_topics = (_topic_protection(each, general, "") for each in element.iterfind("topic_access_rules/*"))
    return replace(
        base,
        domains=own_domains or base.domains,
        topic_rules=(*own_topics, *base.topic_rules),
        origin=Origin("", line(element)),
        domains_origin=None if own_domains else base.origin,
        **_settings(element, STRICT_DOMAIN),
    )


def _topic_protection(element: etree._Element, general: Mapping[str, Any], file: str) -> TopicProtection:
    settings = {**general, **_settings(element, STRICT_TOPIC)}
    return TopicProtection(*_kind_and_expression(element), Origin(file, line(element)), **settings)


def _kind_and_expression(element: etree._Element) -> tuple[str, str]:
    """Return the kind of a ``<topic_rule>``, ``<ros_service_rule>`` and so on, and its expression."""
    kind = str(element.tag).removesuffix("_rule")
    expression = element.find(f"{kind.removeprefix('ros_')}_expression")
    return kind, text(expression) or ""
